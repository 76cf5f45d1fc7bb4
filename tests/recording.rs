//! Contract: a recorded run, replayed, commands the same to the bit, and another setting shows; a recording that was cut off gives
//! its whole chunks and says what was lost; parts, budget and reserve keep what they promise.

mod record_rig;

use noctule::imaging::params::Prefer;
use noctule::io::record::{Entry, RecordOptions, RecordState, RunReader};
use noctule::io::ros::StepKind;
use noctule::io::wire::message::VelocityCommand;
use noctule::service::replay::{recorded_config, replay};
use record_rig::{config, patient, record};
use std::path::Path;
use std::process::Command;

const SETS: usize = 24;

/// Steps, commands and ping sets in a recording, and the bytes lost at its end.
fn census(path: &Path) -> (u64, u64, u64, Option<u64>) {
    let mut reader = RunReader::open(path).expect("opened");
    let (mut steps, mut commands, mut sets) = (0, 0, 0);
    while let Some(entry) = reader.next_entry().expect("whole") {
        match entry {
            Entry::Step(step) => {
                assert_eq!(step.sequence, steps + 1, "steps are in order and none is missing");
                steps += 1;
                sets += u64::from(StepKind::from_number(step.kind) == Some(StepKind::PingSet));
            }
            Entry::Command(_) => commands += 1,
            _ => {}
        }
    }
    (steps, commands, sets, reader.cut().map(|cut| cut.lost_bytes))
}

#[test]
fn a_replay_commands_the_same_to_the_bit_and_another_setting_does_not() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let config = config();
    let (commands, tally) = record(&config, &patient(&path), SETS).expect("recorded");
    assert_eq!((tally.state, tally.dropped_sets, tally.dropped_notes), (RecordState::Finished, 0, 0));
    let moving = commands.iter().filter(|command| command.linear_m_s != 0.0 || command.angular_rad_s != 0.0).count();
    assert!(moving >= 5, "the drive must drive: {moving} of {} commands", commands.len());

    let attached = recorded_config(&path).expect("attached");
    assert_eq!(attached.to_toml(), config.to_toml(), "the configuration travels with the run");
    let mut again: Vec<VelocityCommand> = Vec::new();
    let report = replay(&path, &attached, Prefer::Cpu, |command| again.push(*command)).expect("replayed");
    assert!(report.is_equal(), "{report:?}");
    assert_eq!((report.ping_sets, report.commands as usize), (SETS as u64, commands.len()));
    assert!(report.images as usize >= 3 * SETS - 2, "{report:?}");
    // Against what was decided in memory, not only against what was written.
    for (then, now) in commands.iter().zip(&again) {
        let then = VelocityCommand { epoch: 0, sequence: 0, t_published_ns: 0, ..*then };
        assert_eq!(bytemuck::bytes_of(&then), bytemuck::bytes_of(now));
    }

    // Negative control: another gain is another run.
    let mut other = attached.clone();
    other.control.obstacle_avoidance.threshold *= 0.05;
    other.platform.max_linear_m_s *= 0.5;
    let report = replay(&path, &other, Prefer::Cpu, |_| {}).expect("replayed");
    assert!(!report.is_equal() && report.differing > 0, "{report:?}");
    assert!(report.largest_linear_m_s > 0.0 || report.largest_angular_rad_s > 0.0, "{report:?}");
}

#[test]
fn a_recording_that_was_cut_off_anywhere_gives_its_whole_chunks() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    record(&config(), &patient(&path), 8).expect("recorded");
    let whole = census(&path);
    assert_eq!((whole.2, whole.3), (8, None));
    let bytes = std::fs::read(&path).expect("read");
    let cut = folder.path().join("cut.mcap");
    let (mut last, mut shorter) = (0, 0);
    for percent in [30, 45, 60, 75, 90, 97] {
        let kept = bytes.len() * percent / 100;
        std::fs::write(&cut, &bytes[..kept]).expect("written");
        let (steps, commands, sets, lost) = census(&cut);
        let lost = lost.expect("it is told");
        assert!(lost <= kept as u64 && steps >= last && steps <= whole.0 && commands <= whole.1, "{percent} %");
        // A chunk holds four megabytes, a set here one and a half: no more than that is lost.
        let expected = (8 * percent / 100).saturating_sub(5) as u64;
        assert!(sets >= expected, "{sets} ping sets of {percent} % of eight");
        let report = replay(&cut, &config(), Prefer::Cpu, |_| {});
        if let Ok(report) = report {
            assert_eq!(report.differing, 0, "{percent} %: {report:?}");
            assert!(report.cut.is_some());
        }
        shorter += u64::from(steps < whole.0);
        last = steps;
    }
    assert!(shorter >= 4, "the cuts must cut something");
    // A flipped bit inside is no cut: what is damaged is refused, not believed.
    let mut flipped = bytes.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    std::fs::write(&cut, flipped).expect("written");
    let error = replay(&cut, &config(), Prefer::Cpu, |_| {}).expect_err("refused").to_string();
    assert!(error.contains("cut.mcap") && error.contains("found"), "{error}");
}

#[test]
fn parts_follow_one_another_and_are_read_as_one() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let options = RecordOptions { split_bytes: Some(5 << 20), ..patient(&path) };
    let (commands, _) = record(&config(), &options, 12).expect("recorded");
    let parts = std::fs::read_dir(folder.path()).expect("read").count();
    assert!(parts >= 3 && folder.path().join("run_001.mcap").is_file(), "{parts} parts");
    assert_eq!(census(&path).1 as usize, commands.len());
    assert!(replay(&path, &config(), Prefer::Cpu, |_| {}).expect("replayed").is_equal());
    let later = replay(&folder.path().join("run_001.mcap"), &config(), Prefer::Cpu, |_| {});
    assert!(later.expect_err("no beginning").to_string().contains("first part"));
}

#[test]
fn a_budget_keeps_the_newest_parts_and_touches_nothing_else() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let bystander = folder.path().join("earlier.mcap");
    std::fs::write(&bystander, vec![7; 1 << 20]).expect("written");
    let budget = 14 << 20;
    let options = RecordOptions { split_bytes: Some(4 << 20), budget_bytes: Some(budget), ..patient(&path) };
    record(&config(), &options, 16).expect("recorded");
    let mut parts: Vec<(String, u64)> = std::fs::read_dir(folder.path())
        .expect("read")
        .flatten()
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), entry.metadata().expect("there").len()))
        .filter(|(name, _)| name.starts_with("run"))
        .collect();
    parts.sort();
    let bytes: u64 = parts.iter().map(|(_, len)| len).sum();
    // The open part may hold one ping set and one chunk more than a part.
    assert!(bytes <= budget + (6 << 20), "{bytes} bytes in {parts:?}");
    assert!(!path.exists(), "the oldest went first: {parts:?}");
    assert_eq!(std::fs::read(&bystander).expect("still there").len(), 1 << 20);
}

#[test]
fn an_earlier_recording_is_never_overwritten() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    std::fs::write(&path, "precious").expect("written");
    record(&config(), &patient(&path), 2).expect("recorded");
    assert_eq!(std::fs::read(&path).expect("read"), b"precious");
    assert_eq!(census(&folder.path().join("run-2.mcap")).2, 2);
}

#[test]
fn a_reserve_that_is_reached_ends_the_recording_and_not_the_drive() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let options = RecordOptions { reserve_bytes: u64::MAX / 2, ..patient(&path) };
    let error = record(&config(), &options, 2).expect_err("refused");
    assert_eq!(error.exit_code(), 73);
    assert!(error.to_string().contains("run.mcap") && !path.exists(), "{error}");
}

#[test]
fn a_recorded_run_is_drawn_by_its_own_configuration_and_for_the_sensor_that_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    record(&config(), &patient(&path), 2).expect("recorded");
    let draw = |sensor: &str| {
        let mut program = Command::new(env!("CARGO_BIN_EXE_noctule"));
        program.arg("plot").arg(&path).args(["--sensor", sensor, "--out"]).arg(folder.path().join(sensor));
        program.output().expect("run")
    };
    let pictures = ["front", "left"].map(|sensor| {
        let output = draw(sensor);
        assert!(output.status.success(), "{output:?}");
        std::fs::read(folder.path().join(sensor).join("heard_00000.png")).expect("a picture")
    });
    assert!(pictures[0].starts_with(b"\x89PNG"));
    assert_ne!(pictures[0], pictures[1], "two sensors hear differently");
    let stranger = draw("rear");
    assert_eq!(stranger.status.code(), Some(2), "{stranger:?}");
}
