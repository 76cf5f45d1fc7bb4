//! Contract: every layout of paper 000 drives the office (simulated robot) or the three real scenarios (Husky) without contact,
//! to its goal and without standing for 5 s; nothing is touched in the harder worlds. `NOCTULE_FULL=1`: 15 and 5 starts each.

use noctule::config::{Config, LAYOUT_NAMES};
use noctule::imaging::params::Prefer;
use noctule::service::proving::{Entrant, Programme, Run};
use noctule::service::trial::{Trial, TrialRig};
use noctule::signal::SampleFormat;
use noctule::sim::{SimParams, World};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Longest that a robot may stay in one place while motion is wanted and nobody is near.
const STUCK_MAX_S: f64 = 5.0;

/// How much of the harder worlds is driven but for `NOCTULE_FULL`: 0.1 s of a drive cost 9 ms, and there are six of them.
const HARDER_LIMIT_S: f64 = 60.0;

/// One robot in one world, from a few starts.
struct Entry {
    world_name: &'static str,
    world: World,
    entrant: Entrant,
    first_seed: u64,
    runs: u64,
}

/// A drive, and where it was.
struct Drive {
    world_name: &'static str,
    run: Run,
}

fn entry(world_name: &'static str, name: &str, mut config: Config, first_seed: u64, runs: u64) -> Entry {
    let world = match world_name {
        "office" => World::default_world(),
        file => World::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("fixtures/worlds/{file}.toml"))),
    };
    config.recording.format = SampleFormat::PcmF32;
    let entrant = Entrant { name: name.to_owned(), rig: TrialRig::new(config).unwrap(), losses: Vec::new() };
    Entry { world_name, world: world.unwrap(), entrant, first_seed, runs }
}

fn in_full() -> bool {
    std::env::var_os("NOCTULE_FULL").is_some()
}

/// Seed of the first start and number of starts: one that differs from layout to layout, or `full` for each of them.
fn starts(index: usize, full: u64) -> (u64, u64) {
    if in_full() { (1, full) } else { (index as u64 + 1, 1) }
}

/// Drives everything, as many at a time as there are cores; in the order of the entries.
fn drive(entries: &[Entry]) -> Vec<Drive> {
    let (next, driven) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some((number, entry)) = Some(next.fetch_add(1, Ordering::Relaxed))
            .and_then(|number| entries.get(number).map(|entry| (number, entry)))
        {
            let programme = Programme {
                world: &entry.world,
                entrants: std::slice::from_ref(&entry.entrant),
                acoustics: SimParams::default(),
                prefer: Prefer::Cpu,
                first_seed: entry.first_seed,
                runs: entry.runs,
                jobs: 1,
            };
            let runs = programme.drive(&mut |_| {}).unwrap();
            driven.lock().unwrap().extend(runs.into_iter().map(|run| (number, entry.world_name, run)));
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| (0..cores).for_each(|_| drop(scope.spawn(work))));
    let mut driven = driven.into_inner().unwrap();
    driven.sort_by_key(|(number, _, run)| (*number, run.seed));
    driven.into_iter().map(|(_, world_name, run)| Drive { world_name, run }).collect()
}

/// What a drive is held to.
type Judge = fn(&Trial) -> Vec<&'static str>;

fn touches_nothing(trial: &Trial) -> Vec<&'static str> {
    // A drive without a single step proves nothing.
    let faults = [(trial.score.collided, "contact"), (!(trial.score.path_length_m > 0.1), "did not drive")];
    faults.into_iter().filter_map(|(is, name)| is.then_some(name)).collect()
}

fn drives_well(trial: &Trial) -> Vec<&'static str> {
    let mut faults = touches_nothing(trial);
    if !trial.score.reached_goal {
        faults.push("goal missed");
    }
    if !(trial.longest_stuck_unhindered_s <= STUCK_MAX_S) {
        faults.push("stood too long");
    }
    faults
}

/// A line for every drive with its faults, if there is any fault at all.
fn complaint(drives: &[Drive], judge: Judge) -> Option<String> {
    let mut faulty = drives.is_empty();
    let mut table = String::from("world         layout   seed  time_s  way_m  clear_m  stuck_s  faults\n");
    for Drive { world_name, run } in drives {
        let head = format!("{world_name:<13} {:<8} {:>4}", run.layout, run.seed);
        let line = match &run.outcome {
            Err(error) => {
                faulty = true;
                format!("{head}  {error}\n")
            }
            Ok(trial) => {
                let (score, faults) = (&trial.score, judge(trial));
                faulty |= !faults.is_empty();
                let measured = format!(
                    "{:>7.1} {:>6.1} {:>8.3} {:>8.1}",
                    score.duration_s, score.path_length_m, score.min_clearance_m, trial.longest_stuck_unhindered_s
                );
                format!("{head} {measured}  {}\n", faults.join(", "))
            }
        };
        table.push_str(&line);
    }
    faulty.then_some(table)
}

#[track_caller]
fn hold(entries: &[Entry], judge: Judge) {
    if let Some(table) = complaint(&drive(entries), judge) {
        panic!("\n{table}");
    }
}

#[test]
fn every_layout_of_the_simulated_robot_goes_round_the_office() {
    let layouts = LAYOUT_NAMES.iter().filter(|name| name.starts_with("sim")).enumerate();
    let entries: Vec<Entry> = layouts
        .map(|(index, name)| {
            let (first_seed, runs) = starts(index, 15);
            entry("office", name, Config::layout(name).unwrap(), first_seed, runs)
        })
        .collect();
    assert_eq!(entries.len(), 10);
    hold(&entries, drives_well);
}

#[test]
fn every_layout_of_the_real_robot_masters_the_three_scenarios() {
    let layouts: Vec<&str> = LAYOUT_NAMES.into_iter().filter(|name| name.starts_with("real")).collect();
    assert_eq!(layouts.len(), 6);
    let mut entries = Vec::new();
    for world in ["obstacle", "wall", "t_junction"] {
        for (index, name) in layouts.iter().enumerate() {
            let (first_seed, runs) = starts(index, 5);
            entries.push(entry(world, name, Config::layout(name).unwrap(), first_seed, runs));
        }
    }
    hold(&entries, drives_well);
}

/// Thin pillars, glass and doors hardly wider than the robot may end a way, people may stand in it; none is a reason to touch.
#[test]
fn in_the_harder_worlds_nothing_is_touched() {
    let worlds = ["thin_pillars", "glass", "crossing", "narrow_doors", "warehouse", "apartment"];
    let entries = worlds.map(|world| {
        let (first_seed, runs) = starts(0, 5);
        let mut entry = entry(world, "default", Config::default(), first_seed, runs);
        if !in_full() {
            entry.world.time_limit_s = entry.world.time_limit_s.min(HARDER_LIMIT_S);
        }
        entry
    });
    hold(&entries, touches_nothing);
}

/// The negative control of all of the above.
#[test]
fn a_robot_without_collision_and_obstacle_avoidance_is_found_out() {
    let mut config = Config::default();
    config.control.collision_avoidance.enabled = false;
    config.control.obstacle_avoidance.enabled = false;
    config.control.corridor_following.enabled = false;
    config.control.stuck.enabled = false;
    let blind = drive(&[entry("wall", "blind", config, 1, 1)]);
    for judge in [touches_nothing as Judge, drives_well] {
        let table = complaint(&blind, judge).expect("found out");
        assert!(table.contains("contact"), "{table}");
    }
    assert!(complaint(&[], touches_nothing).is_some(), "nothing driven is nothing proved");

    // A drive that is good, and the same with one thing wrong.
    let mut good = blind.into_iter().next().unwrap().run.outcome.unwrap();
    (good.score.collided, good.score.reached_goal, good.longest_stuck_unhindered_s) = (false, true, 4.9);
    assert_eq!(drives_well(&good), Vec::<&str>::new());
    assert_eq!(drives_well(&Trial { longest_stuck_unhindered_s: 5.1, ..good.clone() }), ["stood too long"]);
    good.score.reached_goal = false;
    assert_eq!((drives_well(&good), touches_nothing(&good)), (vec!["goal missed"], vec![]));
}
