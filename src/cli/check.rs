//! `noctule check`: is this file good, and what follows from it?

use super::args::{CheckArguments, ConfigChoice};
use super::output::print_line;
use super::{Failure, exit};
use crate::config::Config;
use crate::io::recording_file::RecordingFile;
use crate::service::wiring;
use crate::signal::Samples;
use crate::sim::World;
use serde_json::{Value, json};
use std::path::Path;

/// What was found of a file: facts for the reader, and findings that deserve a look.
struct Report {
    facts: Value,
    findings: Vec<String>,
}

/// Checks a configuration, world or recording.
///
/// # Errors
/// Exit 1 with findings, 65 for a bad recording or world, 78 for a bad configuration.
pub fn check(arguments: &CheckArguments) -> Result<(), Failure> {
    let extension = arguments.file.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let report = match extension.as_deref() {
        Some("npy" | "bin") => check_recording(&arguments.file, &arguments.choice)?,
        _ => check_document(&arguments.file)?,
    };
    if arguments.json {
        print_line(
            &json!({"file": arguments.file.display().to_string(), "facts": report.facts, "findings": report.findings})
                .to_string(),
        )?;
    } else {
        if let Value::Object(facts) = &report.facts {
            for (name, value) in facts {
                print_line(&format!("{name}: {}", plain(value)))?;
            }
        }
        for finding in &report.findings {
            print_line(&format!("finding: {finding}"))?;
        }
    }
    if report.findings.is_empty() { Ok(()) } else { Err(Failure::new(exit::FINDING, "")) }
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(items) => items.iter().map(plain).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
    }
}

/// A TOML file is a world when it has a key that only worlds have, else a configuration.
fn check_document(path: &Path) -> Result<Report, Failure> {
    let text = crate::document::read(path).map_err(|error| Failure::new(exit::CONFIG, error))?;
    let keys = ["[[wall]]", "[[pillar]]", "[[mover]]", "[start]", "waypoints"];
    if text.lines().any(|line| keys.iter().any(|key| line.trim_start().starts_with(key))) {
        let world = World::parse(path, &text).map_err(|error| Failure::new(exit::DATA, error))?;
        let facts = json!({
            "kind": "world",
            "walls": world.walls.len(),
            "pillars": world.pillars.len(),
            "movers": world.movers.len(),
            "waypoints": world.waypoints.len(),
        });
        return Ok(Report { facts, findings: Vec::new() });
    }
    let config = Config::load(path).map_err(|error| Failure::new(exit::CONFIG, error))?;
    check_config(&config)
}

fn check_config(config: &Config) -> Result<Report, Failure> {
    let refuse = |error| Failure::new(exit::CONFIG, error);
    let setup = wiring::sensing(config).map_err(refuse)?;
    let masks = wiring::masks(config, &setup).map_err(refuse)?;
    let plan = &setup.plan;
    let mut findings: Vec<String> = config.warnings();
    findings.extend(setup.warnings.iter().cloned());
    let facts = json!({
        "kind": "configuration",
        "sensors": setup.sensors.iter().map(|sensor| sensor.name.clone()).collect::<Vec<_>>(),
        "speed_of_sound_m_s": setup.speed_of_sound_m_s,
        "format": plan.format.as_str(),
        "directions": plan.grid.direction_count(),
        "ranges": plan.grid.range_count(),
        "range_first_m": plan.grid.range_first_m(),
        "range_step_m": plan.grid.range_step_m(),
        "hidden": setup.hidden,
        "mask_rows": masks.table().rows.len(),
        "mask_cells": masks.table().cells.len(),
        "ipc_root": config.ipc.root_path().display().to_string(),
        "ipc_prefix": config.ipc.prefix,
    });
    Ok(Report { facts, findings })
}

fn check_recording(path: &Path, choice: &ConfigChoice) -> Result<Report, Failure> {
    let config = super::config::load(choice)?;
    let data = |error: crate::io::recording_file::RecordingError| Failure::new(exit::DATA, error);
    let mut recording = RecordingFile::open(path, wiring::words_per_ping(&config)).map_err(data)?;
    let shape = recording.shape();
    let mut samples = Samples::zeros(shape.format, 0);
    let mut complete = 0_u64;
    while recording.read_ping(&mut samples).map_err(data)? {
        complete += 1;
    }
    let mut findings = Vec::new();
    if let Err(error) = wiring::recording_for(&config, shape.format, shape.sample_count) {
        findings.push(format!("the configuration does not fit: {error}"));
    }
    let facts = json!({
        "kind": "recording",
        "format": shape.format.as_str(),
        "microphones": shape.channel_count,
        "samples": shape.sample_count,
        "pings": complete,
    });
    Ok(Report { facts, findings })
}
