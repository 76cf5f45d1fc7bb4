//! `noctule record` and `noctule replay`: a run into a file, and out of it again.

use super::args::{ConfigChoice, RecordArguments, ReplayArguments};
use super::output::print_line;
use super::run::{ipc_failure, service_failure, stop_flag};
use super::{Failure, exit};
use crate::config::Config;
use crate::io::Ipc;
use crate::io::record::topics::RecordTopics;
use crate::io::record::{RecordError, RecordState, Recording};
use crate::io::recording_file::is_mcap;
use crate::service::replay::{ReplayReport, recorded_config, replay as run_again};
use crate::service::{tape, wiring};
use crate::time::{Clock, SystemClock};
use serde_json::json;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Pause between two looks at the topics: what keeps one sample keeps it for at least 20 ms.
const LOOK_PAUSE: Duration = Duration::from_millis(2);
/// Longest wait for the file's end.
const FINISH_LIMIT: Duration = Duration::from_secs(10);
/// Ping sets that may wait for the disk; every ping and every image takes a slot of its own here.
const SLOT_COUNT: usize = 32;

fn failure(error: &RecordError) -> Failure {
    Failure::new(error.exit_code(), error)
}

/// Records what passes on the topics.
///
/// # Errors
/// 73 where the file cannot be made or the disk is full, 74 where writing fails, and the codes of the transport.
pub fn record(arguments: &RecordArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let stop = stop_flag()?;
    let setup = wiring::sensing(&config).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let mut options = arguments.limits.options(&arguments.out);
    options.slot_count = SLOT_COUNT;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let subject = tape::subject(&config, &setup);
    let mut topics = RecordTopics::open(&ipc, &setup.raw_shapes(), subject.pings.clone(), options.raw)
        .map_err(|error| ipc_failure(&error))?;
    let mut recording = Recording::start(&options, subject).map_err(|error| failure(&error))?;
    let begun = Instant::now();
    let limit = arguments.duration.map(Duration::from_secs_f64);
    while !stop.load(Ordering::Relaxed) && limit.is_none_or(|limit| begun.elapsed() < limit) {
        topics.poll(SystemClock.now(), &mut recording.tap);
        if recording.recorder.tally().state != RecordState::Recording {
            break;
        }
        std::thread::sleep(LOOK_PAUSE);
    }
    let tally = recording.finish(FINISH_LIMIT).map_err(|error| failure(&error))?;
    print_line(&format!(
        "{} messages, {:.1} MiB; {} ping sets and {} notes lost",
        tally.messages,
        tally.bytes as f64 / f64::from(1 << 20),
        tally.dropped_sets,
        tally.dropped_notes
    ))
}

/// Runs a recording again.
///
/// # Errors
/// 1 when `--compare` finds a difference, 65 for a recording that cannot be used, 74, 78.
pub fn replay(arguments: &ReplayArguments) -> Result<(), Failure> {
    let config = config_for(&arguments.file, arguments.config.as_deref())?;
    let mut made = 0_u64;
    let begun = Instant::now();
    let report = run_again(&arguments.file, &config, arguments.backend.into(), |_| made += 1);
    let report = report.map_err(|error| service_failure(&error))?;
    let took_s = begun.elapsed().as_secs_f64();
    print_line(&if arguments.json { json_of(&report, made, took_s) } else { text_of(&report, made, took_s) })?;
    if arguments.compare && !report.is_equal() {
        return Err(Failure::new(exit::FINDING, ""));
    }
    Ok(())
}

/// The configuration that was named, or the one that a recorded run carries.
///
/// # Errors
/// 65 for a run without one, 78.
pub fn config_of_recording(file: &Path, choice: &ConfigChoice) -> Result<Config, Failure> {
    match &choice.config {
        None if is_mcap(file) => recorded_config(file).map_err(|error| service_failure(&error)),
        _ => super::config::load(choice),
    }
}

fn config_for(file: &Path, other: Option<&Path>) -> Result<Config, Failure> {
    match other {
        Some(path) => Config::load(path).map_err(|error| Failure::new(exit::CONFIG, error)),
        None => recorded_config(file).map_err(|error| service_failure(&error)),
    }
}

fn text_of(report: &ReplayReport, made: u64, took_s: f64) -> String {
    let mut text = format!(
        "{} ping sets in {took_s:.1} s: {made} commands, {} recorded, {} differ",
        report.ping_sets, report.commands, report.differing
    );
    if !report.is_equal() {
        text += &format!(
            "\nlargest difference: V {} m/s, omega {} rad/s, energyscape {:.3e} (relative L2)",
            report.largest_linear_m_s, report.largest_angular_rad_s, report.largest_image_l2
        );
    }
    if report.missing_sets + report.missing_steps > 0 {
        text += &format!(
            "\nnot in the recording: {} ping sets, {} other steps; what follows them may differ for that",
            report.missing_sets, report.missing_steps
        );
    }
    text
}

fn json_of(report: &ReplayReport, made: u64, took_s: f64) -> String {
    json!({
        "equal": report.is_equal(),
        "ping_sets": report.ping_sets,
        "missing_sets": report.missing_sets,
        "missing_steps": report.missing_steps,
        "commands": made,
        "recorded_commands": report.commands,
        "differing_commands": report.differing,
        "largest_linear_m_s": report.largest_linear_m_s,
        "largest_angular_rad_s": report.largest_angular_rad_s,
        "images": report.images,
        "largest_energyscape_l2": report.largest_image_l2,
        "lost_bytes": report.cut.map_or(0, |cut| cut.lost_bytes),
        "took_s": took_s,
    })
    .to_string()
}
