//! `noctule process`: recordings to energyscapes in NumPy files (specification, section 11).
//!
//! One input after the other, ping by ping: memory does not grow with a recording's length. A bad input gets its error
//! and the others go on; a truncated one keeps its complete pings.

use super::args::ProcessArguments;
use super::output::{NewFile, make_folder, progress, write_json, write_npy};
use super::{Failure, exit};
use crate::config::Config;
use crate::imaging::backend::{BackendError, BackendReport};
use crate::imaging::channels::{ChannelFinding, ChannelReport};
use crate::imaging::{Imager, ImagerOptions};
use crate::io::picture;
use crate::io::recording_file::{RecordingError, RecordingFile, RecordingShape};
use crate::service::wiring::{self, SensingSetup};
use crate::signal::{MaskTable, PingSet, PolarGrid, SENSORS_MAX};
use npyz::WriterBuilder as _;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Offline nobody waits for a ping: a software adapter may take its time, and only a hang is given up.
const OFFLINE: ImagerOptions = ImagerOptions { threads: None, gpu_deadline_ms: 10_000 };

/// Runs the command.
///
/// # Errors
/// Exit 65 when any input is bad (after all were tried), 69 without the GPU asked for, 73, 74, 77, 78.
pub fn process(arguments: &ProcessArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let sensor_index = find_sensor(&config, arguments.sensor.as_deref())?;
    make_folder(&arguments.out)?;
    let targets = targets(arguments)?;
    let mut first_failure = None;
    for (input, folder) in &targets {
        let job = Job { config: &config, sensor_index, input, folder, arguments };
        if let Err(failure) = job.run() {
            eprintln!("noctule: {}", failure.message);
            // The exit code is the first failure's: later ones have been told as well.
            first_failure.get_or_insert(failure.code);
        }
    }
    match first_failure {
        Some(code) => Err(Failure::new(code, "")),
        None => Ok(()),
    }
}

fn find_sensor(config: &Config, name: Option<&str>) -> Result<usize, Failure> {
    let Some(name) = name else { return Ok(0) };
    let names: Vec<&str> = config.sensor.iter().map(|sensor| sensor.name.as_str()).collect();
    names.iter().position(|found| *found == name).ok_or_else(|| {
        Failure::new(exit::USAGE, format!("--sensor: found {name}, the configuration has {}", names.join(", ")))
    })
}

/// One input writes into the folder itself, several into a folder each, named by their stems.
fn targets(arguments: &ProcessArguments) -> Result<Vec<(PathBuf, PathBuf)>, Failure> {
    if let [input] = arguments.inputs.as_slice() {
        return Ok(vec![(input.clone(), arguments.out.clone())]);
    }
    let mut targets: Vec<(PathBuf, PathBuf)> = Vec::new();
    for input in &arguments.inputs {
        let stem =
            input.file_stem().ok_or_else(|| Failure::new(exit::USAGE, format!("{}: no file name", input.display())))?;
        let folder = arguments.out.join(stem);
        if let Some((other, _)) = targets.iter().find(|(_, taken)| *taken == folder) {
            let message =
                format!("{} and {} would both write into {}", other.display(), input.display(), folder.display());
            return Err(Failure::new(exit::USAGE, message));
        }
        targets.push((input.clone(), folder));
    }
    Ok(targets)
}

struct Job<'a> {
    config: &'a Config,
    sensor_index: usize,
    input: &'a Path,
    folder: &'a Path,
    arguments: &'a ProcessArguments,
}

impl Job<'_> {
    fn run(&self) -> Result<(), Failure> {
        let words = wiring::words_per_ping(self.config);
        let mut recording = RecordingFile::open(self.input, words).map_err(|error| data_failure(&error))?;
        let setup = self.setup(recording.shape())?;
        let prefer = self.arguments.backend.map_or(self.config.imaging.backend, Into::into);
        let masks = Arc::new(MaskTable::default());
        let mut imager =
            Imager::open(Arc::clone(&setup.plan), masks, prefer, OFFLINE).map_err(|error| backend_failure(&error))?;
        imager.announce();
        make_folder(self.folder)?;
        let images = self.images(&mut recording, &mut imager, &setup)?;
        self.write_axes(&setup.plan.grid)?;
        self.write_meta(&setup, imager.report(), &images)?;
        log::info!("{}: {} pings imaged on {}", self.input.display(), images.count, imager.report().adapter);
        images.ended_by.map_or(Ok(()), Err)
    }

    /// Plans for this one sensor and for what the file says of its samples, where the configuration leaves that open.
    fn setup(&self, shape: RecordingShape) -> Result<SensingSetup, Failure> {
        let bad = |found: String, allowed: String| {
            Failure::new(exit::DATA, format!("{}: found {found}, allowed: {allowed}", self.input.display()))
        };
        let recording = wiring::recording_for(self.config, shape.format, shape.sample_count)
            .map_err(|error| bad(error.found, format!("{} (recording.{})", error.allowed, error.key)))?;
        let setup = wiring::sensing_of_one(self.config, self.sensor_index, &recording)
            .map_err(|error| Failure::new(exit::CONFIG, error))?;
        let channels = setup.plan.sensors[0].channel_count;
        if let Some(found) = shape.channel_count.filter(|found| *found != channels) {
            let name = &setup.sensors[0].name;
            return Err(bad(format!("{found} microphones"), format!("{channels}, as the array of sensor {name} has")));
        }
        Ok(setup)
    }

    fn images(
        &self,
        recording: &mut RecordingFile,
        imager: &mut Imager,
        setup: &SensingSetup,
    ) -> Result<Images, Failure> {
        let grid = &setup.plan.grid;
        let expected = recording.shape().ping_count;
        let raw_len = setup.plan.raw_len(0);
        let mut pings = PingSet::empty(1, setup.plan.format, &[raw_len]);
        pings.present = [true, false, false];
        let mut images = Images::default();
        let values = self.folder.join("energyscape.npy.values");
        let mut spool = NewFile::create(&values)?;
        let bar = progress(expected as u64, "imaging");
        loop {
            match recording.read_ping(pings.pings[0].samples_mut()) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    images.ended_by = Some(data_failure(&error));
                    break;
                }
            }
            let image = imager.image(&pings).map_err(|error| backend_failure(&error))?;
            let energyscape = &image.energyscapes[0];
            images.channels.push(channel_summary(&image.channels[0]));
            if image.channels[0].gains.iter().all(|gain| *gain == 0.0) {
                eprintln!(
                    "noctule: {}: ping {}: every channel is left out, the image is zero",
                    self.input.display(),
                    images.count
                );
            }
            std::io::Write::write_all(&mut spool, bytemuck::cast_slice(&energyscape.values))?;
            if self.arguments.png {
                let picture = picture::render_energyscape(energyscape);
                let path = self.folder.join(format!("energyscape_{:05}.png", images.count));
                picture::write_png(&path, &picture).map_err(|error| super::output::cannot_create(&path, &error))?;
            }
            pings.sequence += 1;
            pings.pings[0].sequence += 1;
            images.count += 1;
            bar.inc(1);
        }
        bar.finish_and_clear();
        if images.count == 0 {
            return Err(images.ended_by.unwrap_or_else(|| Failure::new(exit::DATA, "no ping")));
        }
        spool.finish()?;
        let result = self.assemble(&values, images.count, grid);
        let _ = std::fs::remove_file(&values);
        result.map(|()| images)
    }

    /// Puts the header, which holds the number of pings and so is known last, before the values.
    fn assemble(&self, values: &Path, count: usize, grid: &PolarGrid) -> Result<(), Failure> {
        let shape = [count as u64, grid.direction_count() as u64, grid.range_count() as u64];
        let mut file = NewFile::create(&self.folder.join("energyscape.npy"))?;
        npyz::WriteOptions::<f32>::new().default_dtype().shape(&shape).writer(&mut file).begin_nd()?;
        std::io::copy(&mut std::fs::File::open(values)?, &mut file)?;
        file.finish()
    }

    fn write_axes(&self, grid: &PolarGrid) -> Result<(), Failure> {
        let azimuths = grid.directions().iter().map(|direction| direction.azimuth_rad.to_degrees());
        let path = self.folder.join("directions_deg.npy");
        let count = grid.direction_count() as u64;
        if grid.is_horizontal() {
            write_npy(&path, &[count], &azimuths.collect::<Vec<f64>>())?;
        } else {
            let pairs: Vec<f64> = azimuths
                .zip(grid.directions())
                .flat_map(|(azimuth_deg, direction)| [azimuth_deg, direction.elevation_rad.to_degrees()])
                .collect();
            write_npy(&path, &[count, 2], &pairs)?;
        }
        write_npy(&self.folder.join("ranges_m.npy"), &[grid.range_count() as u64], &grid.ranges_m())
    }

    fn write_meta(&self, setup: &SensingSetup, report: &BackendReport, images: &Images) -> Result<(), Failure> {
        let plan = &setup.plan;
        let hidden: Vec<f64> = plan.sensors[0]
            .hidden
            .iter()
            .zip(plan.grid.directions())
            .filter_map(|(hidden, direction)| hidden.then_some(direction.azimuth_rad.to_degrees()))
            .collect();
        let meta = json!({
            "noctule_version": env!("CARGO_PKG_VERSION"),
            "input": self.input.display().to_string(),
            "config": self.arguments.choice.config.as_ref().map(|path| path.display().to_string()),
            "sensor": setup.sensors[0].name,
            "backend": report.kind.as_str(),
            "adapter": report.adapter,
            "backend_reason": report.reason,
            "pings": images.count,
            "complete": images.ended_by.is_none(),
            "format": plan.format.as_str(),
            "sample_rate_hz": plan.sample_rate_hz * plan.decimation as f64,
            "demodulated_rate_hz": plan.sample_rate_hz,
            "samples": plan.raw_count,
            "microphones": plan.sensors[0].channel_count,
            "speed_of_sound_m_s": setup.speed_of_sound_m_s,
            "band_hz": [setup.sensors[0].emission.band_hz.0, setup.sensors[0].emission.band_hz.1],
            "range_first_m": plan.grid.range_first_m(),
            "range_step_m": plan.grid.range_step_m(),
            "hidden_directions_deg": hidden,
            "channels": images.channels,
        });
        write_json(&self.folder.join("meta.json"), &meta)
    }
}

#[derive(Default)]
struct Images {
    count: usize,
    channels: Vec<Value>,
    ended_by: Option<Failure>,
}

/// The channels that are not good, by what is wrong with them; empty lists are left out.
fn channel_summary(report: &ChannelReport) -> Value {
    let of = |kind: ChannelFinding| -> Vec<usize> {
        report.findings.iter().enumerate().filter_map(|(index, found)| (*found == kind).then_some(index)).collect()
    };
    let mut summary = serde_json::Map::new();
    for (name, kind) in [
        ("disabled", ChannelFinding::Disabled),
        ("not_finite", ChannelFinding::NotFinite),
        ("stuck", ChannelFinding::Stuck),
        ("clipped", ChannelFinding::Clipped),
    ] {
        let channels = of(kind);
        if !channels.is_empty() {
            summary.insert(name.to_owned(), json!(channels));
        }
    }
    Value::Object(summary)
}

/// The failure for a recording that cannot be used.
pub fn data_failure(error: &RecordingError) -> Failure {
    let code = match error {
        RecordingError::Io { error, .. } if error.kind() == std::io::ErrorKind::PermissionDenied => exit::PERMISSION,
        RecordingError::Io { error, .. } if error.kind() != std::io::ErrorKind::NotFound => exit::IO,
        _ => exit::DATA,
    };
    Failure::new(code, error)
}

/// The failure for a backend that cannot be opened or used.
pub fn backend_failure(error: &BackendError) -> Failure {
    let code = match error {
        BackendError::PingShape { .. } => exit::DATA,
        BackendError::Unavailable(_) | BackendError::Lost(_) | BackendError::Timeout { .. } => exit::UNAVAILABLE,
        BackendError::Invalid(_) | BackendError::Cpu(_) => exit::INTERNAL,
    };
    Failure::new(code, error)
}

const _: () = assert!(SENSORS_MAX == 3, "the flags of a single-sensor ping set are written out above");
