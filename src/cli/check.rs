//! `noctule check`: is this file good, and what follows from it?

use super::args::{CheckArguments, ConfigChoice};
use super::output::print_line;
use super::{Failure, exit};
use crate::config::Config;
use crate::imaging::channels::ChannelFinding;
use crate::imaging::direct_path::{ChannelMap, DirectPath, HEARD_MIN};
use crate::io::recording_file::{RecordingFile, is_recording};
use crate::sensor::{EmissionParams, SensorParams};
use crate::service::wiring::{self, SensingSetup};
use crate::signal::{RawPing, Samples};
use crate::sim::World;
use crate::time::Stamp;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;

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
    let report = match is_recording(&arguments.file) {
        true => check_recording(&arguments.file, &arguments.choice)?,
        false => check_document(&arguments.file)?,
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
        "emissions": emission_facts(config),
        "format": plan.format.as_str(),
        "directions": plan.grid.direction_count(),
        "ranges": plan.grid.range_count(),
        "range_first_m": plan.grid.range_first_m(),
        "range_step_m": plan.grid.range_step_m(),
        "hidden": setup.hidden,
        "mask_rows": masks.table().rows.len(),
        "mask_cells": masks.table().cells.len(),
        "calibration": calibration_facts(config),
        "ipc_root": config.ipc.root_path().display().to_string(),
        "ipc_prefix": config.ipc.prefix,
    });
    Ok(Report { facts, findings })
}

/// Who sends what when, a sentence a sensor.
fn emission_facts(config: &Config) -> Vec<String> {
    let sentence = |(index, sensor): (usize, &SensorParams)| {
        let EmissionParams { shape, start_hz, end_hz, duration_s, .. } = config.emission_of(index);
        let shape = format!("{shape:?}").to_lowercase();
        let (start_khz, end_khz, turn_ms) = (start_hz / 1e3, end_hz / 1e3, 1e3 * config.slot_s() * index as f64);
        format!("{} {shape} {start_khz} to {end_khz} kHz in {} ms at {turn_ms:.1} ms", sensor.name, 1e3 * duration_s)
    };
    config.sensor.iter().enumerate().map(sentence).collect()
}

/// What of a calibration is in force; null without one.
fn calibration_facts(config: &Config) -> Value {
    let Some(measured) = &config.calibration.measured else { return Value::Null };
    let sensors: Vec<Value> = measured
        .sensor
        .iter()
        .map(|sensor| {
            json!({
                "name": sensor.name,
                "pings": sensor.pings,
                "air_temperature_c": sensor.air_temperature_c,
                "air_temperature_sd_c": sensor.air_temperature_sd_c,
                "emitter_m": sensor.emitter_m,
                "misplaced": sensor.misplaced,
                "unheard": sensor.unheard,
            })
        })
        .collect();
    json!({"recorded": measured.recorded, "applied": config.calibration.apply, "sensors": sensors})
}

fn check_recording(path: &Path, choice: &ConfigChoice) -> Result<Report, Failure> {
    let config = super::record::config_of_recording(path, choice)?;
    let data = |error: crate::io::recording_file::RecordingError| Failure::new(exit::DATA, error);
    let mut recording = RecordingFile::open(path, wiring::file_hints(&config)).map_err(data)?;
    let shape = recording.shape();
    let mut findings = Vec::new();
    let fitting = wiring::recording_for(&config, shape.format, shape.sample_count);
    let mut listener = match fitting.and_then(|format| wiring::sensing_of_one(&config, 0, &format)) {
        Ok(setup) => Some(Listener::new(setup)),
        Err(error) => {
            findings.push(format!("the configuration does not fit: {error}"));
            None
        }
    };
    let mut samples = Samples::zeros(shape.format, 0);
    let mut complete = 0_u64;
    while recording.read_ping(&mut samples).map_err(data)? {
        complete += 1;
        if let Some(listener) = &mut listener {
            samples = listener.listen(samples);
        }
    }
    let facts = json!({
        "kind": "recording",
        "format": shape.format.as_str(),
        "microphones": shape.channel_count,
        "samples": shape.sample_count,
        "pings": complete,
        "direct_path": listener.map_or(Value::Null, |listener| listener.facts()),
    });
    Ok(Report { facts, findings })
}

/// What the pings of a recording tell of the first sensor's emitter and array.
struct Listener {
    setup: SensingSetup,
    direct_path: DirectPath,
    heard: u64,
    map: ChannelMap,
}

impl Listener {
    fn new(setup: SensingSetup) -> Self {
        let direct_path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
        Self { setup, direct_path, heard: 0, map: ChannelMap::Unknown }
    }

    /// Listens to a ping and gives its samples back.
    fn listen(&mut self, samples: Samples) -> Samples {
        let samples = Arc::new(samples);
        let ping =
            RawPing { sensor_index: 0, sequence: 0, emitted_at: Stamp::default(), samples: Arc::clone(&samples) };
        let found = self.direct_path.listen(&self.setup.plan, &ping);
        self.heard += u64::from(found.correlation >= HEARD_MIN);
        self.map = found.map;
        drop(ping);
        Arc::unwrap_or_clone(samples)
    }

    fn facts(&self) -> Value {
        let unfit = self.direct_path.unfit(0).iter().enumerate();
        let unfit: Vec<usize> = unfit.filter(|(_, found)| **found != ChannelFinding::Good).map(|(k, _)| k).collect();
        let fit = self.direct_path.calibration(0).map(|found| {
            json!({
                "residual_m": found.residual_m,
                "speed_of_sound_m_s": found.speed_of_sound_m_s,
                "emitter_m": [found.emitter_m.x, found.emitter_m.y, found.emitter_m.z],
                "late_s": found.offset_s,
            })
        });
        let map = match self.map {
            ChannelMap::Unknown => "unknown",
            ChannelMap::Fits => "fits",
            ChannelMap::Doubted => "doubted",
            ChannelMap::Wrong => "wrong",
        };
        json!({"sensor": self.setup.sensors[0].name, "pings_heard": self.heard, "array": map, "unfit_channels": unfit, "fit": fit})
    }
}
