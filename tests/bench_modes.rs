//! Contract: what `bench` says beside its table: times from last sample to command by the real processes, time and memory against
//! sizes without a cliff, and which questions it refuses.

use noctule::config::Config;
use serde_json::Value;
use std::process::{Command, Output};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_noctule")).arg("bench").args(arguments).output().expect("runs")
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object and nothing else")
}

fn left_behind() -> Vec<String> {
    let names = |folder: &str| -> Vec<String> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    };
    let folder = std::env::temp_dir();
    let ours = |name: &String| name.starts_with("noctule-bench-") || name.starts_with("nb");
    [names(&folder.to_string_lossy()), names("/dev/shm")].concat().into_iter().filter(ours).collect()
}

#[test]
fn latency_is_that_of_daemon_and_controller_and_nothing_is_left_of_them() {
    let before = left_behind();
    let report = json(&bench(&["--latency", "--sets", "30", "--json", "--backend", "cpu"]));
    let path = &report["latency"][0];
    assert_eq!((&path["source"], &path["load"], &path["backend"]), (&"live".into(), &"idle".into(), &"cpu".into()));
    let times = &path["to_controller"];
    let of = |times: &Value, key: &str| times[key].as_f64().expect("a number");
    assert!(of(times, "count") >= 25.0, "{path}");
    let order = ["p50_ms", "p99_ms", "p99_9_ms", "max_ms"].map(|key| of(times, key));
    assert!(order[0] > 0.0 && order.is_sorted(), "{path}");
    assert!(of(&path["to_published"], "p50_ms") <= order[0], "published before it is received: {path}");
    let transport = report["transport"].as_array().expect("rows");
    assert_eq!(transport.len(), 2);
    for hop in transport {
        assert!(of(hop, "count") >= 100.0 && of(hop, "p50_ms") < order[0], "a part takes less than the whole: {hop}");
    }
    let new: Vec<String> = left_behind().into_iter().filter(|name| !before.contains(name)).collect();
    assert!(new.is_empty(), "left behind: {new:?}");
}

#[test]
fn emission_plans_are_compared_by_what_they_reject_blur_and_cost() {
    let report = json(&bench(&["--emissions", "--places", "1", "--json"]));
    let rows = report["emissions"].as_array().expect("rows");
    let of = |name: &str, key: &str| {
        let row = rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("{name}: {rows:?}"));
        row[key].clone()
    };
    assert_eq!(rows.len(), 5);
    let (same, bands, turns) = ("together, same sweep", "together, bands", "in turn, same sweep");
    assert!(of(same, "rejection_db").is_null() && of(bands, "rejection_db").as_f64().expect("a number") > 30.0);
    let width = |name: &str| of(name, "width_m").as_f64().expect("a number");
    assert!(width(bands) > 2.0 * width(same) && width(turns) == width(same));
    let added = |name: &str| of(name, "added_s").as_f64().expect("a number");
    assert!(added(same) == 0.0 && (added(turns) - 0.0634).abs() < 1e-9, "{}", added(turns));
    assert_eq!(of(same, "robot")["ping_sets"], 4);
    assert!(of(turns, "other_robot").is_null());
    let refused = bench(&["--places", "3"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
}

#[test]
fn time_and_memory_grow_with_the_work_and_never_fall_off_a_cliff() {
    let folder = tempfile::tempdir().expect("folder");
    let plot = folder.path().join("scaling.png");
    let plot = plot.to_str().expect("path");
    let report = json(&bench(&["--scaling", "--json", "--iterations", "5", "--plot", plot]));
    let rows = report["scaling"].as_array().expect("rows");
    let of = |row: &Value, key: &str| row[key].as_f64().expect("a number");
    for (axis, key, last) in [
        ("microphones", "microphones", 256.0),
        ("directions", "directions", 4000.0),
        ("directions in 3-D", "directions", 4000.0),
        ("sensors", "sensors", 3.0),
        ("samples", "samples", 32_768.0),
    ] {
        let rows: Vec<&Value> = rows.iter().filter(|row| row["axis"] == axis).collect();
        assert_eq!(of(rows.last().expect("rows"), key), last);
        for pair in rows.windows(2) {
            let grown = |key: &str| of(pair[1], key) / of(pair[0], key);
            // Shortest times of five: on an idle machine an operation takes at most 1.6 times as long from one row to the next.
            assert!(grown("min_ms") < 6.0 * grown("floor_operations"), "{axis}: {pair:?}");
        }
    }
    for row in rows {
        // Two ping sets and their copies, the spectra of beams beside the image, and 16 MiB for the program itself.
        let bound = 16.0 * 1_048_576.0 + 3.0 * of(row, "raw_bytes") + 8.0 * of(row, "image_bytes");
        assert!(row["peak_rss_bytes"].as_f64().is_none_or(|peak| peak < bound), "{row}: at most {bound} bytes");
    }
    assert!(std::fs::read(plot).expect("plot").starts_with(b"\x89PNG"));
}

#[test]
fn every_row_has_its_floor_and_its_memory() {
    let report = json(&bench(&["--json", "--backend", "cpu", "--sensors", "1", "--iterations", "3"]));
    let rows = report["results"].as_array().expect("rows");
    assert_eq!(rows.len(), 8);
    assert!(report["machine"]["multiply_adds_per_s"].as_f64() > Some(1e8));
    assert!(report["machine"]["memory_bytes_per_s"].as_f64() > Some(1e8));
    for row in rows {
        assert!(row["floor_ms"].as_f64() > Some(0.0), "{row}");
        assert!(row["peak_rss_bytes"].as_u64().is_none_or(|bytes| bytes > 1 << 20), "{row}");
    }
}

#[test]
fn senseless_questions_are_usage_errors() {
    for arguments in [
        &["--sets", "10"][..],
        &["--busy"],
        &["--plot", "x.png"],
        &["--latency", "--sets", "0"],
        &["--scaling", "--latency"],
        &["--sensors", "4"],
    ] {
        assert_eq!(bench(arguments).status.code(), Some(2), "{arguments:?}");
    }
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("one.toml");
    std::fs::write(&path, "config_version = 1\n[[sensor]]\nname = \"front\"\n").expect("file");
    assert_eq!(Config::load(&path).expect("valid").sensor.len(), 1);
    let output = bench(&["--sensors", "2", "--config", path.to_str().expect("path")]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}
