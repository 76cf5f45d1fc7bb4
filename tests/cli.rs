//! Contract: exit codes, what goes to standard output and what to standard error, and the files of `process`, `masks`,
//! `config`, `check`, `topics`, `bench`, `run` and `demo`, as other programs rely on them. Every test has its own IPC root.

use assert_cmd::Command;
use noctule::config::Config;
use noctule::service::{simulator, wiring};
use noctule::signal::{SampleFormat, Samples};
use noctule::sim::{SimParams, World};
use noctule::time::Stamp;
use npyz::WriterBuilder as _;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use tempfile::TempDir;

/// A folder, an IPC root and a prefix of a test's own.
struct Room {
    folder: TempDir,
    prefix: String,
}

impl Room {
    fn new() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let prefix = format!("t{}x{}_", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        Self { folder: tempfile::tempdir().expect("folder"), prefix }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A configuration with an IPC root of this test's own.
    fn config(&self, text: &str) -> PathBuf {
        let path = self.path("robot.toml");
        let ipc = format!("\n[ipc]\nroot = \"{}\"\nprefix = \"{}\"\n", self.path("ipc").display(), self.prefix);
        std::fs::write(&path, format!("config_version = 1\n{text}{ipc}")).expect("configuration");
        path
    }
}

fn noctule() -> Command {
    let mut command = Command::cargo_bin("noctule").expect("the program is built");
    command.timeout(std::time::Duration::from_secs(60));
    command
}

fn npy_header(path: &Path) -> (String, Vec<u64>) {
    let file = npyz::NpyFile::new(std::fs::File::open(path).expect("file")).expect("header");
    let npyz::DType::Plain(kind) = file.dtype() else { panic!("a plain array") };
    (kind.to_string(), file.shape().to_vec())
}

fn npy_f64(path: &Path) -> Vec<f64> {
    npyz::NpyFile::new(std::fs::File::open(path).expect("file")).expect("header").into_vec().expect("values")
}

fn npy_f32(path: &Path) -> Vec<f32> {
    npyz::NpyFile::new(std::fs::File::open(path).expect("file")).expect("header").into_vec().expect("values")
}

/// Pings of the front sensor in front of a wall at 2 m, as raw samples.
fn wall_pings(format: SampleFormat, count: usize) -> Vec<Samples> {
    let mut config = Config::default();
    config.sensor.truncate(1);
    config.sensor[0].mount.distance_m = 0.0;
    config.recording.format = format;
    let text = "[[wall]]\npoints = [[2.0, -3.0], [2.0, 3.0]]\n[start]\ncorner = [0.0, 0.0]\nsize = [0.0, 0.0]\n";
    let world = World::parse(Path::new("wall.toml"), text).expect("world");
    let setup = wiring::sensing(&config).expect("setup");
    let mut simulator = simulator(&config, &setup, world, SimParams::default(), 7).expect("simulator");
    let mut pings = simulator.empty_ping_set();
    (0..count)
        .map(|_| {
            simulator.ping_set(Stamp::default(), &mut pings);
            (*pings.pings[0].samples).clone()
        })
        .collect()
}

fn write_pcm(path: &Path, pings: &[Samples]) {
    let file = std::fs::File::create(path).expect("file");
    let samples = pings[0].len() as u64 / 32;
    let shape = [pings.len() as u64, 32, samples];
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().expect("header");
    for ping in pings {
        let Samples::PcmF32(values) = ping else { panic!("f32 pings") };
        writer.extend(values.iter().copied()).expect("values");
    }
    writer.finish().expect("end");
}

fn write_bin(path: &Path, pings: &[Samples]) {
    let words = pings.iter().flat_map(|ping| match ping {
        Samples::Pdm(words) => words.clone(),
        _ => panic!("PDM pings"),
    });
    let bytes: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
    std::fs::write(path, bytes).expect("file");
}

/// Range and bearing of the largest cell of the first ping in a folder of results.
fn peak(folder: &Path) -> (f64, f64) {
    let values = npy_f32(&folder.join("energyscape.npy"));
    let (ranges, bearings) = (npy_f64(&folder.join("ranges_m.npy")), npy_f64(&folder.join("directions_deg.npy")));
    let cells = ranges.len() * bearings.len();
    let best = (0..cells).max_by(|a, b| values[*a].total_cmp(&values[*b])).expect("cells");
    (ranges[best % ranges.len()], bearings[best / ranges.len()])
}

#[test]
fn process_puts_a_wall_where_it_is_from_pcm_and_from_pdm() {
    let room = Room::new();
    let config = room.config("[[sensor]]\nname = \"front\"\n");
    write_pcm(&room.path("wall.npy"), &wall_pings(SampleFormat::PcmF32, 2));
    write_bin(&room.path("wall.bin"), &wall_pings(SampleFormat::Pdm, 1));
    for (input, pings) in [("wall.npy", 2), ("wall.bin", 1)] {
        let out = room.path("out").join(input);
        let mut command = noctule();
        command.arg("process").arg(room.path(input)).arg("--config").arg(&config).arg("--out").arg(&out);
        command.args(["--backend", "cpu", "--png"]).assert().success().stdout("");
        let (kind, shape) = npy_header(&out.join("energyscape.npy"));
        let ranges = npy_f64(&out.join("ranges_m.npy")).len() as u64;
        assert_eq!((kind.as_str(), shape), ("<f4", vec![pings, 180, ranges]));
        assert_eq!(npy_header(&out.join("directions_deg.npy")), ("<f8".to_owned(), vec![180]));
        let (range_m, bearing_deg) = peak(&out);
        // The emitter stands 6 cm above the microphones: half the way is sqrt(2^2 + 0.03^2) = 2.0002 m. One bin is 5 mm.
        assert!((range_m - 2.0).abs() < 0.006 && bearing_deg.abs() <= 0.5, "{input}: {range_m} m, {bearing_deg} deg");
        let meta: Value = serde_json::from_slice(&std::fs::read(out.join("meta.json")).expect("meta")).expect("JSON");
        assert_eq!(
            (&meta["pings"], &meta["backend"], &meta["sensor"]),
            (&pings.into(), &"cpu".into(), &"front".into())
        );
        assert!(std::fs::read(out.join("energyscape_00000.png")).expect("picture").starts_with(b"\x89PNG"));
        let left_behind = std::fs::read_dir(&out).expect("folder").flatten().map(|entry| entry.file_name());
        assert!(left_behind.into_iter().all(|name| !name.to_string_lossy().contains("partial")), "no half files");
    }
}

#[test]
fn a_bad_input_gets_its_error_and_65_and_the_others_are_imaged() {
    let room = Room::new();
    let config = room.config("[[sensor]]\nname = \"front\"\n");
    let pings = wall_pings(SampleFormat::Pdm, 2);
    write_bin(&room.path("good.bin"), &pings[..1]);
    write_bin(&room.path("cut.bin"), &pings);
    let file = std::fs::OpenOptions::new().write(true).open(room.path("cut.bin")).expect("file");
    file.set_len(163_840 * 4 + 1000).expect("cut");
    std::fs::write(room.path("garbage.npy"), b"not a recording").expect("garbage");
    let mut command = noctule();
    command.arg("process").args(["garbage.npy", "cut.bin", "good.bin"].map(|name| room.path(name)));
    let output = command.arg("--config").arg(&config).arg("--out").arg(room.path("out")).output().expect("runs");
    assert_eq!(output.status.code(), Some(65));
    let talk = String::from_utf8_lossy(&output.stderr);
    assert!(talk.contains("garbage.npy") && talk.contains("no NumPy header"), "{talk}");
    assert!(talk.contains("cut.bin") && talk.contains("truncated"), "{talk}");
    assert_eq!(npy_header(&room.path("out/good/energyscape.npy")).1[0], 1);
    assert_eq!(npy_header(&room.path("out/cut/energyscape.npy")).1[0], 1, "the complete ping is kept");
    assert!(!room.path("out/garbage/energyscape.npy").exists());
}

#[test]
fn dead_channels_leave_a_finite_image_and_are_reported() {
    let room = Room::new();
    let config = room.config("[[sensor]]\nname = \"front\"\n");
    let mut pings = wall_pings(SampleFormat::PcmF32, 1);
    if let Samples::PcmF32(values) = &mut pings[0] {
        values[5 * 16_384 + 77] = f32::NAN;
        values[9 * 16_384..10 * 16_384].fill(0.25);
    }
    write_pcm(&room.path("sick.npy"), &pings);
    write_pcm(&room.path("dead.npy"), &[Samples::PcmF32(vec![0.0; 32 * 16_384])]);
    let mut command = noctule();
    command.arg("process").args(["sick.npy", "dead.npy"].map(|name| room.path(name)));
    let output = command.arg("--config").arg(&config).arg("--out").arg(room.path("out")).output().expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let meta = |name: &str| -> Value {
        serde_json::from_slice(&std::fs::read(room.path("out").join(name).join("meta.json")).expect("meta"))
            .expect("JSON")
    };
    assert_eq!(meta("sick")["channels"][0]["not_finite"], serde_json::json!([5]));
    assert_eq!(meta("sick")["channels"][0]["stuck"], serde_json::json!([9]));
    let values = npy_f32(&room.path("out/sick/energyscape.npy"));
    assert!(values.iter().all(|value| value.is_finite()) && values.iter().any(|value| *value > 0.01));
    assert!(npy_f32(&room.path("out/dead/energyscape.npy")).iter().all(|value| *value == 0.0), "a zero image");
    assert!(String::from_utf8_lossy(&output.stderr).contains("every channel"), "and it says so");
}

#[test]
fn usage_configuration_and_missing_files_have_their_exit_codes() {
    let room = Room::new();
    let code = |arguments: &[&str]| noctule().args(arguments).output().expect("runs").status.code();
    assert_eq!(code(&["--help"]), Some(0));
    assert_eq!(code(&["fly"]), Some(2));
    assert_eq!(code(&["run", "--source", "nowhere"]), Some(2));
    assert_eq!(code(&["demo", "--duration", "-3"]), Some(2));
    assert_eq!(code(&["config", "--config", "/nonexistent/robot.toml"]), Some(78));
    let bad = room.path("bad.toml");
    std::fs::write(&bad, "[safety]\nmax_age_ms = 0\n").expect("file");
    let output = noctule().args(["run", "--config"]).arg(&bad).output().expect("runs");
    let talk = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(78), "{talk}");
    assert!(talk.contains("bad.toml") && talk.contains("max_age_ms") && talk.contains("allowed"), "{talk}");
    assert!(output.stdout.is_empty(), "talk goes to standard error");
}

#[test]
fn the_default_configuration_loads_again_and_is_checked_without_findings() {
    let room = Room::new();
    let text = noctule().args(["config", "--default"]).output().expect("runs").stdout;
    let path = room.path("default.toml");
    std::fs::write(&path, &text).expect("file");
    let again = noctule().arg("config").arg("--config").arg(&path).output().expect("runs");
    assert_eq!(String::from_utf8_lossy(&again.stdout), String::from_utf8_lossy(&text));
    let checked = noctule().arg("check").arg(&path).arg("--json").output().expect("runs");
    assert_eq!(checked.status.code(), Some(0), "{}", String::from_utf8_lossy(&checked.stdout));
    let report: Value = serde_json::from_slice(&checked.stdout).expect("JSON");
    assert_eq!(report["facts"]["sensors"], serde_json::json!(["front", "left", "right"]));
    noctule().arg("check").arg(path.with_file_name("missing.toml")).assert().code(78);
}

#[test]
fn masks_are_ternary_arrays_and_pictures_for_every_layer_and_sensor() {
    let room = Room::new();
    noctule().args(["masks", "--out"]).arg(room.path("masks")).assert().success();
    for layer in ["collision_avoidance", "obstacle_avoidance", "flow_following", "corridor_following"] {
        let mut sides = [0_usize; 2];
        for sensor in ["front", "left", "right"] {
            let path = room.path("masks").join(format!("mask_{layer}_{sensor}.npy"));
            let (kind, shape) = npy_header(&path);
            assert_eq!((kind.as_str(), shape[0]), ("|i1", 180));
            let values: Vec<i8> = npyz::NpyFile::new(std::fs::File::open(&path).expect("file"))
                .expect("header")
                .into_vec()
                .expect("values");
            assert!(values.iter().all(|value| (-1..=1).contains(value)));
            sides[0] += values.iter().filter(|value| **value > 0).count();
            sides[1] += values.iter().filter(|value| **value < 0).count();
            assert!(path.with_extension("png").is_file());
        }
        assert!(sides[0] > 0 && sides[1] > 0, "{layer}: {sides:?}");
        assert!(room.path("masks").join(format!("masks_{layer}.png")).is_file());
    }
    for picture in ["regions", "flow_lines_front", "flow_lines_left", "flow_lines_right"] {
        assert!(room.path("masks").join(picture).with_extension("png").is_file(), "{picture}");
    }
}

#[test]
fn masks_of_a_layout_are_those_of_its_sensors_and_no_other_layout_is_taken() {
    let room = Room::new();
    noctule().args(["masks", "--layout", "sim-5", "--out"]).arg(room.path("masks")).assert().success();
    assert!(room.path("masks").join("mask_flow_following_sonar2.npy").is_file());
    assert!(room.path("masks").join("flow_lines_sonar2.png").is_file());
    assert!(!room.path("masks").join("flow_lines_sonar3.png").is_file(), "sim-5 has two sensors");
    noctule().args(["masks", "--layout", "sim-11", "--out"]).arg(room.path("none")).assert().code(2);
    let both = ["masks", "--layout", "sim-5", "--config", "robot.toml", "--out"];
    noctule().args(both).arg(room.path("none")).assert().code(2);
}

#[test]
fn topics_json_names_root_prefix_and_every_offset() {
    let room = Room::new();
    let config = room.config("");
    let output = noctule().args(["topics", "--json", "--config"]).arg(&config).output().expect("runs");
    let json: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(json["root"], room.path("ipc").to_string_lossy().as_ref());
    let services = json["services"].as_array().expect("services");
    let command = services.iter().find(|service| service["name"] == "noctule/command").expect("the command");
    assert_eq!(command["payload"]["type_name"], "noctule.VelocityCommand.v1");
    assert_eq!(command["payload"]["slice"], false);
    let image =
        services.iter().find(|service| service["name"] == "noctule/sonar/front/energyscape").expect("the image");
    assert_eq!((&image["payload"]["type_name"], &image["payload"]["slice"]), (&"f32".into(), &true.into()));
    let fields = image["header"]["fields"].as_array().expect("fields");
    assert!(
        fields.iter().any(|field| field["name"] == "range_step_m" && field["type"] == "f64" && field["count"] == 1)
    );
}

#[test]
fn bench_times_every_stage_for_one_to_three_sensors() {
    let output = noctule().args(["bench", "--json", "--backend", "cpu", "--iterations", "3"]).output().expect("runs");
    let json: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let results = json["results"].as_array().expect("results");
    for sensors in 1..=3 {
        for stage in
            ["demodulate", "matched_filter", "delay_and_sum", "envelope", "focus", "masked_energy", "image", "total"]
        {
            let row = results.iter().find(|row| row["sensors"] == sensors && row["stage"] == stage).expect("row");
            assert_eq!(row["backend"], "cpu");
            assert!(row["threads"].is_u64() && row["median_ms"].as_f64().expect("time") >= 0.0);
            assert!(row["max_ms"].as_f64() >= row["median_ms"].as_f64());
        }
        let total = results.iter().find(|row| row["sensors"] == sensors && row["stage"] == "total").expect("row");
        assert!(total["median_ms"].as_f64().expect("time") > 0.0);
    }
}

#[test]
fn the_demo_drives_arms_itself_and_sums_up() {
    let room = Room::new();
    let config = room.config("");
    let mut command = noctule();
    command.args(["demo", "--headless", "--json", "--duration", "6", "--config"]).arg(&config);
    let output = command.output().expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: Value = serde_json::from_slice(&output.stdout).expect("one JSON object and nothing else");
    let count = |name: &str| summary[name].as_u64().unwrap_or_default();
    assert!(count("ping_sets") >= 20, "{summary}");
    assert!(count("commands_applied") * 10 >= count("commands_published") * 8, "{summary}");
    assert_eq!(
        (&summary["backend"], &summary["sensors"]),
        (&"cpu".into(), &serde_json::json!(["front", "left", "right"]))
    );
    let latency = &summary["latency_ms"];
    assert!(latency["p50"].as_f64() > Some(0.0) && latency["max"].as_f64() >= latency["p99"].as_f64(), "{summary}");
    let shares: f64 = summary["layer_share"].as_object().expect("shares").values().filter_map(Value::as_f64).sum();
    assert!((shares - 1.0).abs() < 1e-6, "{summary}");
    let left: Vec<_> =
        std::fs::read_dir("/dev/shm").into_iter().flatten().flatten().map(|entry| entry.file_name()).collect();
    let ours: Vec<_> =
        left.iter().map(|name| name.to_string_lossy()).filter(|name| name.starts_with(&room.prefix)).collect();
    assert!(ours.iter().all(|name| name.contains("global_mgmt")), "left behind: {ours:?}");
}

#[test]
fn replay_of_a_recording_runs_to_its_end() {
    let room = Room::new();
    let config = room.config("[recording]\nformat = \"pcm-f32\"\n[[sensor]]\nname = \"front\"\n");
    write_pcm(&room.path("wall.npy"), &wall_pings(SampleFormat::PcmF32, 3));
    let mut command = noctule();
    let source = format!("replay:{}", room.path("wall.npy").display());
    command.args(["run", "--source", &source, "--config"]).arg(&config).assert().success();
    let source = format!("replay:{}", room.path("nothing.npy").display());
    noctule().args(["run", "--source", &source, "--config"]).arg(&config).assert().code(65);
}

#[test]
fn soak_prints_one_object_and_exits_0_when_nothing_is_found() {
    let room = Room::new();
    let arguments = ["soak", "--minutes", "0.2", "--seed", "5", "--fault-every", "4", "--config"];
    let output = noctule().args(arguments).arg(room.config("")).output().expect("output");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    let summary: Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(output.status.code(), Some(0), "{told}\n{summary}");
    assert_eq!(summary["findings"], serde_json::json!([]));
    assert!(summary["ping_sets"].as_u64() >= Some(100) && summary["troubles"].as_u64() >= Some(1), "{summary}");
    noctule().args(["soak", "--minutes", "0"]).assert().code(2);
}

#[test]
fn what_is_typed_wrong_is_told_with_what_is_allowed_and_what_was_meant() {
    let room = Room::new();
    let config = room.config("").display().to_string();
    std::fs::write(room.path("afile"), "x").expect("file");
    std::fs::write(room.path("world.toml"), "waypoints = [[1.0, 1.0]]\n").expect("file");
    let (file, world) = (room.path("afile").display().to_string(), room.path("world.toml").display().to_string());
    let folder = room.path("").display().to_string();
    let missing = room.path("missing.npy").display().to_string();
    let cases: [(&[&str], i32, &str); 15] = [
        (&["process", &missing, "--out", &folder], 65, "missing.npy: found no such file, allowed: a .npy"),
        (
            &["process", &config, "--out", &folder],
            65,
            "found another kind of file, allowed: a .npy, .npz, .wav, .bin or .mcap file",
        ),
        (&["process", &missing, "--out", &file], 73, "found a file where a folder is needed"),
        (&["process", &missing, "--out", &folder, "--sensor", "frnt"], 2, "did you mean front?"),
        (&["plot", &folder], 65, "found a folder without results"),
        (&["plot", &file], 65, "found another kind of file"),
        (&["simulate", "ofice"], 65, "allowed: office (built in), or a file; did you mean office?"),
        (&["simulate", &config], 65, "this is a configuration, not a world"),
        (&["simulate", "office", "--layout", "sm-3"], 2, "did you mean sim-3?"),
        (&["status", "--config", &world], 78, "this is a world, not a configuration"),
        (&["status", "--config", &missing], 78, "`noctule config --default > "),
        (&["echo", "comand", "--config", &config], 2, "did you mean noctule/command?"),
        (&["arm", "--config", &config], 69, "is the daemon running?"),
        (&["config", "import", &file], 65, "allowed: one JSON object of settings"),
        (&["detect", "ring"], 65, "found nothing, allowed: one JSON object"),
    ];
    for (arguments, code, expected) in cases {
        let output = noctule().args(arguments).output().expect("runs");
        let talk = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {talk}");
        assert!(talk.contains(expected), "{arguments:?}: {talk}");
    }
}
