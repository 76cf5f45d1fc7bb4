//! Contract: the files, lines, JSON keys and exit codes of `simulate`, with and without `--sweep`, as other programs rely on
//! them; runs depend on world, layout and seed only. Worlds here are a second or two long, so that a run takes a moment.

use assert_cmd::Command;
use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::service::proving::{Entrant, Programme, Told};
use noctule::service::sweep::{self, Sight};
use noctule::service::trial::TrialRig;
use noctule::sim::{SimParams, World};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A closed corridor of 2.4 m; the goal lies 0.15 m ahead of the start.
const CORRIDOR: &str = "waypoints = [[0.45, 0.0]]
time_limit_s = 1.5
[[wall]]
points = [[-2.0, -1.2], [6.0, -1.2], [6.0, 1.2], [-2.0, 1.2]]
closed = true
[start]
corner = [-0.1, -0.2]
size = [0.2, 0.4]
heading_spread_deg = 10.0
";

const KEYS: [&str; 11] = [
    "layout",
    "seed",
    "collided",
    "reached_goal",
    "waypoints_reached",
    "longest_stuck_s",
    "duration_s",
    "path_length_m",
    "min_clearance_m",
    "mean_speed_m_s",
    "layer_share",
];

struct Room(TempDir);

impl Room {
    fn with_world(text: &str) -> Self {
        let room = Self(tempfile::tempdir().expect("folder"));
        std::fs::write(room.path("world.toml"), text).expect("world");
        room
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// `noctule --quiet simulate world.toml --backend cpu ARGUMENTS`, run in the folder.
    fn simulate(&self, arguments: &[&str]) -> Command {
        let mut command = Command::cargo_bin("noctule").expect("the program is built");
        command.timeout(std::time::Duration::from_secs(120)).current_dir(self.0.path());
        command.args(["--quiet", "simulate", "world.toml", "--backend", "cpu"]).args(arguments);
        command
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).expect("file")).expect("JSON")
    }

    /// Header and rows of a CSV file.
    fn csv(&self, name: &str) -> (Vec<String>, Vec<Vec<String>>) {
        let mut reader = csv::Reader::from_path(self.path(name)).expect("file");
        let words = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
        let header = words(reader.headers().expect("header"));
        (header, reader.records().map(|row| words(&row.expect("row"))).collect())
    }
}

fn stderr_of(command: &mut Command, code: i32) -> String {
    let output = command.output().expect("runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{said}");
    said
}

#[test]
fn the_json_has_the_keys_of_the_contract_for_every_layout_and_seed() {
    let room = Room::with_world(CORRIDOR);
    let output = room.simulate(&["--layout", "4,real-4", "--runs", "2", "--seed", "7", "--json", "runs.json"]).output();
    let output = output.expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let json = room.json("runs.json");
    let runs = json["runs"].as_array().expect("runs");
    let order: Vec<_> =
        runs.iter().map(|run| (run["layout"].as_str().unwrap(), run["seed"].as_u64().unwrap())).collect();
    assert_eq!(order, [("sim-4", 7), ("sim-4", 8), ("real-4", 7), ("real-4", 8)]);
    for run in runs {
        let object = run.as_object().expect("object");
        assert!(KEYS.iter().all(|key| object.contains_key(*key)), "{run}");
        assert!(run["collided"].is_boolean() && run["reached_goal"].is_boolean() && run["waypoints_reached"].is_u64());
        let shares = run["layer_share"].as_object().expect("shares");
        assert!((shares.values().filter_map(Value::as_f64).sum::<f64>() - 1.0).abs() < 1e-9, "{run}");
        assert!(shares.contains_key("collision_avoidance") && shares.contains_key("corridor_following"));
        // At 0.3 m/s at most, from a standing start.
        let (way_m, time_s) = (run["path_length_m"].as_f64().unwrap(), run["duration_s"].as_f64().unwrap());
        assert!(way_m > 0.0 && way_m < 0.3 * time_s, "{run}");
        assert!((run["mean_speed_m_s"].as_f64().unwrap() - way_m / time_s).abs() < 1e-9);
    }
    assert_eq!(json["summary"]["runs"], 4);
    assert_eq!(json["summary"]["layouts"]["real-4"]["runs"], 2);
    let reached = runs.iter().filter(|run| run["reached_goal"] == true).count();
    assert!(reached >= 1, "a goal 0.15 m ahead is reached in 1.5 s: {json}");
    assert_eq!(json["summary"]["reached_goal"], reached);
    let table = String::from_utf8(output.stdout).expect("text");
    let lines: Vec<&str> = table.lines().collect();
    let layouts: Vec<_> = lines[1..5].iter().map(|line| line.split_whitespace().next().unwrap()).collect();
    assert_eq!(layouts, ["sim-4", "sim-4", "real-4", "real-4"], "a line a run, in the order of the runs: {table}");
}

#[test]
fn json_on_standard_output_stands_there_alone() {
    let room = Room::with_world(CORRIDOR);
    let output = room.simulate(&["--json", "-"]).output().expect("runs");
    let json: Value = serde_json::from_slice(&output.stdout).expect("one JSON object and nothing else");
    assert_eq!((&json["runs"][0]["layout"], &json["runs"][0]["seed"]), (&"default".into(), &1.into()));
}

#[test]
fn the_number_of_jobs_changes_no_byte() {
    let room = Room::with_world(CORRIDOR);
    for jobs in ["1", "2"] {
        let arguments = ["--layout", "sim-2,sim-9", "--runs", "2", "--jobs", jobs];
        let mut command = room.simulate(&arguments);
        command.args(["--json", &format!("{jobs}.json"), "--trajectories", jobs]).assert().success();
    }
    let bytes = |name: &str| std::fs::read(room.path(name)).expect("file");
    assert_eq!(bytes("1.json"), bytes("2.json"));
    for name in ["sim-2_1.csv", "sim-2_2.csv", "sim-9_1.csv", "sim-9_2.csv"] {
        assert_eq!(bytes(&format!("1/{name}")), bytes(&format!("2/{name}")), "{name}");
    }
    assert_ne!(bytes("1/sim-2_1.csv"), bytes("1/sim-2_2.csv"), "another seed is another run");
}

#[test]
fn harder_conditions_change_the_run() {
    let room = Room::with_world(CORRIDOR);
    let harder: [&[&str]; 3] = [&[], &["--noise-db", "10"], &["--multipath"]];
    let files: Vec<Vec<u8>> = harder
        .iter()
        .map(|arguments| {
            room.simulate(&["--trajectories", "out"]).args(*arguments).assert().success();
            std::fs::read(room.path("out/default_1.csv")).expect("file")
        })
        .collect();
    assert!(files[0] != files[1] && files[0] != files[2] && files[1] != files[2]);
}

#[test]
fn a_trajectory_has_units_in_its_header_and_a_row_a_ping_set() {
    let room = Room::with_world(CORRIDOR);
    room.simulate(&["--layout", "2", "--trajectories", "tracks", "--json", "runs.json"]).assert().success();
    let (header, rows) = room.csv("tracks/sim-2_1.csv");
    let expected = "time_s,x_m,y_m,heading_deg,linear_m_s,angular_rad_s,wanted_linear_m_s,wanted_angular_rad_s,\
                    decided_linear_m_s,decided_angular_rad_s,layer,state,gate,stuck,clearance_m,mover_clearance_m,\
                    cause_sensor,cause_range_m,cause_bearing_deg,cause_energy,cause_threshold";
    assert_eq!(header.join(","), expected);
    let run = &room.json("runs.json")["runs"][0];
    let duration_s = run["duration_s"].as_f64().unwrap();
    assert_eq!(rows.len(), (duration_s / 0.1 - 1e-6).ceil() as usize, "ten ping sets a second");
    let way_m: f64 = rows
        .windows(2)
        .map(|pair| {
            let place = |row: &[String]| (row[1].parse::<f64>().unwrap(), row[2].parse::<f64>().unwrap());
            let (a, b) = (place(&pair[0]), place(&pair[1]));
            (a.0 - b.0).hypot(a.1 - b.1)
        })
        .sum();
    // The last ping set's tenth of a second is not in the rows.
    assert!((way_m - run["path_length_m"].as_f64().unwrap()).abs() < 0.035, "{way_m}");
    assert!(rows.iter().all(|row| row[15].is_empty()), "no mover, no distance to one");
    let left_behind: Vec<_> = std::fs::read_dir(room.path("tracks")).unwrap().flatten().collect();
    assert_eq!(left_behind.len(), 1, "no half files");
}

#[test]
fn drives_are_drawn_as_heat_map_as_ways_and_as_what_was_heard() {
    let room = Room::with_world(CORRIDOR);
    let pictures = ["--plot", "heat.png", "--paths", "ways.png", "--frames", "film.png"];
    room.simulate(&[&["--layout", "1,4"][..], &pictures].concat()).assert().success();
    for name in ["heat.png", "ways.png", "film.png"] {
        assert!(std::fs::read(room.path(name)).expect("picture").starts_with(b"\x89PNG"), "{name}");
    }
}

#[test]
fn a_lost_sensor_shows_in_the_states() {
    let room = Room::with_world(CORRIDOR);
    room.simulate(&["--lose", "left@0.7", "--trajectories", "tracks"]).assert().success();
    let (header, rows) = room.csv("tracks/default_1.csv");
    let column = |name: &str| header.iter().position(|found| found == name).expect("column");
    let (time, state) = (column("time_s"), column("state"));
    for row in &rows {
        let time_s: f64 = row[time].parse().unwrap();
        let expected = if time_s < 0.65 { "ACTIVE" } else { "DEGRADED" };
        assert_eq!(row[state], expected, "{time_s}");
    }
}

#[test]
fn what_does_not_exist_is_refused_with_what_does() {
    let room = Room::with_world(CORRIDOR);
    let said = stderr_of(&mut room.simulate(&["--layout", "sim-11"]), 2);
    assert!(said.contains("sim-11") && said.contains("sim-10") && said.contains("real-6") && said.contains("default"));
    let said = stderr_of(&mut room.simulate(&["--layout", "11"]), 2);
    assert!(said.contains("\"11\""), "{said}");
    let said = stderr_of(&mut room.simulate(&["--lose", "nose@3"]), 2);
    assert!(said.contains("\"nose\"") && said.contains("front, left, right"), "{said}");
    for wrong in ["left", "left@soon", "@3", "left@-1"] {
        assert!(stderr_of(&mut room.simulate(&["--lose", wrong]), 2).contains("SENSOR@S"), "{wrong}");
    }
    std::fs::write(room.path("robot.toml"), "config_version = 1\n").unwrap();
    stderr_of(&mut room.simulate(&["--config", "robot.toml", "--layout", "1"]), 2);
    stderr_of(&mut room.simulate(&["--runs", "0"]), 2);
    stderr_of(&mut room.simulate(&["--runs", "2", "--seed", "18446744073709551615"]), 2);
}

#[test]
fn a_bad_world_or_configuration_is_named_with_its_key_before_anything_is_driven() {
    let room = Room::with_world(&format!("{CORRIDOR}[[pillar]]\ncentre = [3.0, 0.0]\nradius_m = -0.1\n"));
    let said = stderr_of(&mut room.simulate(&["--json", "runs.json"]), 65);
    assert!(said.contains("world.toml") && said.contains("radius_m") && said.contains("-0.1"), "{said}");
    assert!(!room.path("runs.json").exists());
    std::fs::write(room.path("world.toml"), CORRIDOR).unwrap();
    std::fs::write(room.path("robot.toml"), "[platform]\nradius_m = 0.0\n").unwrap();
    let said = stderr_of(&mut room.simulate(&["--config", "robot.toml"]), 78);
    assert!(said.contains("robot.toml") && said.contains("radius_m"), "{said}");
    stderr_of(&mut room.simulate(&["--json", "nowhere/runs.json"]), 73);
    stderr_of(&mut room.simulate(&["--plot", "nowhere/plot.png"]), 73);
}

#[test]
fn the_name_of_a_configuration_is_the_layouts_and_its_recording_is_kept() {
    let room = Room::with_world(CORRIDOR);
    std::fs::write(room.path("my robot.toml"), "[recording]\nformat = \"pcm-i16\"\n[[sensor]]\nname = \"nose\"\n")
        .unwrap();
    room.simulate(&["--config", "my robot.toml", "--trajectories", "tracks", "--json", "runs.json"]).assert().success();
    assert_eq!(room.json("runs.json")["runs"][0]["layout"], "my robot");
    assert!(room.path("tracks/my robot_1.csv").exists());
}

#[test]
fn a_run_that_cannot_begin_is_named_and_the_others_are_kept() {
    // A Husky does not fit between walls 0.8 m apart, the small robot does.
    let narrow = CORRIDOR.replace("1.2]", "0.4]").replace("-1.2", "-0.4").replace("[0.2, 0.4]", "[0.2, 0.0]");
    let room = Room::with_world(&narrow.replace("[-0.1, -0.2]", "[-0.1, 0.0]"));
    let said = stderr_of(&mut room.simulate(&["--layout", "real-1,sim-1", "--json", "runs.json"]), 65);
    assert!(said.contains("real-1, seed 1") && said.contains("no room"), "{said}");
    let json = room.json("runs.json");
    let layouts: Vec<_> = json["runs"].as_array().unwrap().iter().map(|run| run["layout"].as_str().unwrap()).collect();
    assert_eq!(layouts, ["sim-1"]);
    assert_eq!((&json["failed"][0]["layout"], &json["summary"]["failed"]), (&"real-1".into(), &1.into()));
}

#[test]
fn a_contact_is_a_result_and_no_error() {
    // Somebody walks into the robot from behind, where the built-in robot may see him but cannot outrun him.
    let mover = "[[mover]]\nradius_m = 0.2\npath = [[-1.5, 0.0], [4.0, 0.0]]\nspeed_m_s = 2.0\nloop = \"once\"\n";
    let room = Room::with_world(&format!("{}{mover}", CORRIDOR.replace("0.45", "4.0")));
    let output = room.simulate(&["--json", "runs.json"]).output().expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(room.json("runs.json")["summary"]["collided"], 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("CONTACT"));
}

#[test]
fn a_sweep_ranks_drawn_layouts_beside_the_given_one_and_writes_all_of_it() {
    let room = Room::with_world(CORRIDOR);
    let arguments = ["--sweep", "2", "--layout", "sim-4", "--json", "sweep.json", "--plot", "sweep.png"];
    let output = room.simulate(&arguments).output().expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let json = room.json("sweep.json");
    let ranking = json["ranking"].as_array().expect("ranking");
    assert_eq!(ranking.len(), 3);
    assert_eq!(json["runs"].as_array().expect("runs").len() + json["failed"].as_array().expect("failed").len(), 3);
    let mut names: Vec<&str> = ranking.iter().map(|entry| entry["layout"].as_str().unwrap()).collect();
    let table = String::from_utf8(output.stdout).unwrap();
    for (index, name) in names.iter().enumerate() {
        assert!(
            table.lines().nth(1 + index).unwrap().contains(name),
            "the table has the order of the ranking: {table}"
        );
    }
    names.sort_unstable();
    assert_eq!(names, ["drawn-1", "drawn-2", "sim-4"]);
    let key = |entry: &Value| {
        let score = &entry["score"];
        let count = |name: &str| score[name].as_u64().unwrap();
        let time_s = score["time_to_goal_s"].as_f64().unwrap_or(f64::INFINITY);
        ((count("collided"), count("goals_missed"), count("near_misses")), time_s)
    };
    assert!(ranking.windows(2).all(|pair| key(&pair[0]) <= key(&pair[1])), "{json}");
    for entry in ranking {
        // What is printed for copying makes the same sensors.
        let text = entry["toml"].as_str().unwrap();
        let config = Config::parse(text, Path::new("copied.toml")).expect("a configuration");
        assert_eq!(config.sensor.len(), entry["sensors"].as_array().unwrap().len());
        assert_eq!(Some(config.sensor[0].mount.bearing_deg), entry["sensors"][0]["mount"]["bearing_deg"].as_f64());
    }
    assert!(std::fs::read(room.path("sweep.png")).expect("picture").starts_with(b"\x89PNG"));
}

fn pcm(mut config: Config) -> Config {
    config.recording.format = noctule::signal::SampleFormat::PcmF32;
    config
}

#[test]
fn drawn_layouts_stand_on_the_robot_see_ahead_and_follow_from_the_seed() {
    let config = pcm(Config::layout("sim-4").unwrap());
    let radius_m = config.platform.radius_m;
    let draw = |count, seed| sweep::draw(&config, count, seed, &mut || ()).expect("candidates");
    let drawn = draw(2, 3);
    let mounts = |entrants: &[Entrant]| -> Vec<Vec<_>> {
        let of = |entrant: &Entrant| entrant.rig.config().sensor.iter().map(|sensor| sensor.mount).collect();
        entrants.iter().map(of).collect()
    };
    for entrant in &drawn {
        let sensors = &entrant.rig.config().sensor;
        assert!((1..=3).contains(&sensors.len()));
        assert!(sensors.iter().all(|sensor| sensor.mount.distance_m <= radius_m), "within the footprint");
        let coverage = Sight::new(&entrant.rig).coverage();
        assert!(coverage.ahead_m >= radius_m && coverage.around_share > 0.1 && coverage.around_share <= 1.0);
    }
    assert_eq!(mounts(&drawn[..1]), mounts(&draw(1, 3)));
    assert_ne!(mounts(&drawn[..1]), mounts(&draw(1, 4)));
    let all = mounts(&drawn);
    assert!(all.iter().enumerate().all(|(index, one)| !all[..index].contains(one)), "all different");
}

#[test]
fn sight_is_a_half_plane_beyond_the_deaf_range() {
    // One sensor at the centre looking ahead, 180 directions of 1 deg: it sees what is ahead of it from its first range on.
    let mut config = pcm(Config::default());
    config.sensor.truncate(1);
    config.sensor[0].mount.distance_m = 0.0;
    let rig = TrialRig::new(config).expect("rig");
    let sight = Sight::new(&rig);
    let seen = |x_m: f64, y_m: f64| sight.seen_by([x_m, y_m].into());
    assert_eq!((seen(1.0, 0.0), seen(0.1, 1.0), seen(-0.1, 1.0), seen(0.05, 0.0)), (1, 1, 0, 0));
    // A circle around the sensor: one half of it.
    assert!((sight.coverage().around_share - 0.5).abs() < 0.01, "{}", sight.coverage().around_share);
}

#[test]
fn scores_are_ordered_by_contact_then_goal_then_near_miss_then_time() {
    let config = pcm(Config::layout("sim-1").unwrap());
    let entrant = Entrant { name: "one".into(), rig: TrialRig::new(config).unwrap(), losses: Vec::new() };
    let none = sweep::SweepScore::of(&entrant, std::iter::empty());
    let score = |contacts, goals_missed, near_misses, time_s| sweep::SweepScore {
        contacts,
        goals_missed,
        near_misses,
        time_to_goal_s: time_s,
        ..none.clone()
    };
    let best_first = [
        score(0, 0, 0, Some(30.0)),
        score(0, 0, 0, Some(31.0)),
        score(0, 0, 1, Some(20.0)),
        score(0, 1, 0, Some(10.0)),
        score(0, 1, 0, None),
        score(1, 0, 0, Some(5.0)),
    ];
    assert!(best_first.windows(2).all(|pair| pair[0].compare(&pair[1]).is_lt()));
}

#[test]
fn runs_are_told_in_order_whatever_finishes_first() {
    // A run with three sensors takes longer than one with a single sensor.
    let world =
        World::parse(Path::new("w.toml"), &CORRIDOR.replace("time_limit_s = 1.5", "time_limit_s = 0.8")).unwrap();
    let entrant = |name: &str, layout: &str| Entrant {
        name: name.into(),
        rig: TrialRig::new(pcm(Config::layout(layout).unwrap())).unwrap(),
        losses: Vec::new(),
    };
    let entrants = [entrant("three sensors", "sim-4"), entrant("one sensor", "sim-1")];
    let programme = Programme {
        world: &world,
        entrants: &entrants,
        acoustics: SimParams::default(),
        prefer: Prefer::Cpu,
        first_seed: 5,
        runs: 2,
        jobs: 4,
    };
    let (mut told, mut last) = (Vec::new(), (0, 0));
    let runs = programme.drive(&mut |what| match what {
        Told::Finished(run) => told.push((run.entrant, run.seed)),
        Told::Progress { sets, of } => {
            assert!(sets >= last.0 && sets <= of, "progress goes on to its end");
            last = (sets, of);
        }
    });
    assert_eq!(told, [(0, 5), (0, 6), (1, 5), (1, 6)]);
    assert_eq!(last, (32, 32), "8 ping sets of 4 runs");
    let runs = runs.expect("driven");
    assert_eq!(runs.iter().map(|run| (run.entrant, run.seed)).collect::<Vec<_>>(), told);
}
