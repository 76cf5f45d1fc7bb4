//! One recording to its four files: `energyscape.npy`, `directions_deg.npy`, `ranges_m.npy`, `meta.json`, and pictures; or the
//! arrays together in `energyscape.npz`.
//!
//! In: a target and a [`Crew`] of imagers, kept from one recording to the next. Out: the files, each complete or not at all,
//! `meta.json` last. What grows with the number of pings goes to disk as it comes.

use super::super::args::ExportFormat;
use super::super::output::{NewFile, make_folder, write_npy, write_picture};
use super::super::{Failure, exit};
use super::export;
use super::finished::{Fingerprint, picture_name};
use super::inputs::Target;
use super::team::{self, Images};
use super::{Batch, Chosen, OFFLINE, backend_failure, data_failure};
use crate::imaging::Imager;
use crate::imaging::backend::{BackendReport, Image};
use crate::imaging::channels::{ChannelFinding, ChannelReport};
use crate::io::picture;
use crate::io::recording_file::{RecordingFile, RecordingShape};
use crate::sensor::RecordingFormat;
use crate::service::wiring::{self, SensingSetup};
use crate::signal::{MaskTable, PolarGrid};
use npyz::WriterBuilder as _;
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A plan and imagers for it.
pub struct Crew {
    setup: SensingSetup,
    imagers: Vec<Imager>,
}

/// One recording's work.
pub struct Job<'a> {
    /// What all recordings have in common.
    pub batch: &'a Batch<'a>,
    /// The recording.
    pub target: &'a Target,
    /// What it is now.
    pub fingerprint: &'a Fingerprint,
}

impl Job<'_> {
    /// Images the recording; `crew` holds the last recording's imagers, which serve again when the pings are alike.
    ///
    /// # Errors
    /// Exit 65 for a recording that cannot be used or ends in the middle of a ping, whose complete pings are imaged all the
    /// same; 69, 73, 74, 77, 78.
    pub fn run(&self, crew: &mut Option<Crew>) -> Result<(), Failure> {
        let hints = wiring::file_hints(self.batch.config);
        let mut recording = RecordingFile::open_sensor(&self.target.input, hints, self.batch.sensor_index)
            .map_err(|error| data_failure(&error))?;
        let Crew { setup, imagers } = self.crew(crew, recording.shape())?;
        let folder = &self.target.folder;
        make_folder(folder)?;
        // From here on the folder is not finished, whatever it was.
        remove(&folder.join("meta.json"))?;
        let outputs = Outputs { job: self, png: self.batch.arguments.png };
        let spools = Spools::create(folder, recording.shape().ping_count as u64, &setup.plan.grid)?;
        let ended = team::image_all(&mut recording, imagers, &setup.plan, &outputs, spools)?;
        if ended.count == 0 {
            return Err(ended.cut_short.unwrap_or_else(|| Failure::new(exit::DATA, "no ping")));
        }
        let Spools { energyscape, channels } = ended.written;
        finish_energyscape(energyscape, ended.count, &setup.plan.grid)?;
        self.write_axes(&setup.plan.grid)?;
        let pictures = self.remove_old_pictures(ended.count)?;
        let report = imagers[0].report();
        let mut meta = self.meta(setup, report);
        meta["pings"] = json!(ended.count);
        meta["complete"] = json!(ended.cut_short.is_none());
        meta["pictures"] = json!(pictures);
        let arrays = match self.batch.arguments.format {
            ExportFormat::Npy => folder.join("energyscape.npy"),
            ExportFormat::Npz => export::into_archive(folder, &meta)?,
        };
        meta["energyscape_bytes"] = json!(std::fs::metadata(arrays)?.len());
        write_meta(&folder.join("meta.json"), &meta, channels)?;
        self.batch.bar.suspend(|| {
            log::info!("{}: {} pings imaged on {}", self.target.input.display(), ended.count, report.adapter);
        });
        ended.cut_short.map_or(Ok(()), Err)
    }

    /// The last recording's crew, or a new one if this recording's pings are of another format, rate or length.
    fn crew<'c>(&self, crew: &'c mut Option<Crew>, shape: RecordingShape) -> Result<&'c mut Crew, Failure> {
        let bad = |found: String, allowed: String| {
            Failure::new(exit::DATA, format!("{}: found {found}, allowed: {allowed}", self.target.input.display()))
        };
        let recording = wiring::recording_for(self.batch.config, shape.format, shape.sample_count)
            .map_err(|error| bad(error.found, format!("{} (recording.{})", error.allowed, error.key)))?;
        if crew.as_ref().is_none_or(|crew| crew.setup.recording != recording) {
            *crew = None;
        }
        let crew = match crew {
            Some(crew) => crew,
            None => crew.insert(self.new_crew(&recording)?),
        };
        let channels = crew.setup.plan.sensors[0].channel_count;
        if let Some(found) = shape.channel_count.filter(|found| *found != channels) {
            let name = &crew.setup.sensors[0].name;
            return Err(bad(format!("{found} microphones"), format!("{channels}, as the array of sensor {name} has")));
        }
        Ok(crew)
    }

    fn new_crew(&self, recording: &RecordingFormat) -> Result<Crew, Failure> {
        let batch = self.batch;
        let setup = wiring::sensing_of_one(batch.config, batch.sensor_index, recording)
            .map_err(|error| Failure::new(exit::CONFIG, error))?;
        let masks = Arc::new(MaskTable::default());
        let open = |_| {
            let (plan, masks) = (Arc::clone(&setup.plan), Arc::clone(&masks));
            match &batch.chosen {
                Chosen::Cpu { reason } => Imager::with_backends(plan, masks, None, OFFLINE.threads, reason),
                Chosen::Gpu { prefer } => Imager::open(plan, masks, *prefer, OFFLINE),
            }
            .map_err(|error| backend_failure(&error))
        };
        let imagers: Vec<Imager> = (0..batch.imagers_per_recording).map(open).collect::<Result<_, _>>()?;
        batch.announced.call_once(|| batch.bar.suspend(|| imagers[0].announce()));
        Ok(Crew { setup, imagers })
    }

    fn write_axes(&self, grid: &PolarGrid) -> Result<(), Failure> {
        let azimuths = grid.directions().iter().map(|direction| direction.azimuth_rad.to_degrees());
        let path = self.target.folder.join("directions_deg.npy");
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
        write_npy(&self.target.folder.join("ranges_m.npy"), &[grid.range_count() as u64], &grid.ranges_m())
    }

    /// Removes pictures beyond the last ping, left by a longer recording of the same name; gives the number of pictures.
    fn remove_old_pictures(&self, count: u64) -> Result<u64, Failure> {
        if !self.batch.arguments.png {
            return Ok(0);
        }
        let mut index = count;
        while remove(&self.target.folder.join(picture_name(index)))? {
            index += 1;
        }
        Ok(count)
    }

    fn meta(&self, setup: &SensingSetup, report: &BackendReport) -> Value {
        let plan = &setup.plan;
        let hidden: Vec<f64> = plan.sensors[0]
            .hidden
            .iter()
            .zip(plan.grid.directions())
            .filter_map(|(hidden, direction)| hidden.then_some(direction.azimuth_rad.to_degrees()))
            .collect();
        let config = &self.batch.arguments.choice.config;
        json!({
            "noctule_version": env!("CARGO_PKG_VERSION"),
            "fingerprint": self.fingerprint,
            "input": self.target.input.display().to_string(),
            "config": config.as_ref().map(|path| path.display().to_string()),
            "sensor": setup.sensors[0].name,
            "backend": report.kind.as_str(),
            "adapter": report.adapter,
            "backend_reason": report.reason,
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
        })
    }
}

/// What happens to each image.
struct Outputs<'a> {
    job: &'a Job<'a>,
    png: bool,
}

/// Where values and findings go while their number is not known yet.
struct Spools {
    energyscape: NewFile,
    channels: BufWriter<File>,
}

impl Spools {
    fn create(folder: &Path, expected: u64, grid: &PolarGrid) -> Result<Self, Failure> {
        let mut energyscape = NewFile::create(&folder.join("energyscape.npy"))?;
        let header = npy_header(expected, grid)?;
        energyscape.write_all(&header).map_err(|error| energyscape.failure(&error))?;
        // Without a name at once, so that nothing is left of it however the process ends.
        let path: PathBuf = folder.join("channels.partial");
        let cannot = |error: std::io::Error| super::super::output::cannot_create(&path, &error);
        let file = File::options().read(true).write(true).create(true).truncate(true).open(&path).map_err(cannot)?;
        std::fs::remove_file(&path).map_err(cannot)?;
        Ok(Self { energyscape, channels: BufWriter::new(file) })
    }
}

impl Images for Outputs<'_> {
    type Written = Spools;

    fn beside(&self, index: u64, image: &Image) -> Result<(), Failure> {
        if self.png {
            let picture = picture::render_energyscape(&image.energyscapes[0]);
            write_picture(&self.job.target.folder.join(picture_name(index)), &picture)?;
        }
        Ok(())
    }

    fn in_order(&self, spools: &mut Spools, index: u64, image: &Image) -> Result<(), Failure> {
        let bar = &self.job.batch.bar;
        let (values, channels) = (&image.energyscapes[0].values, &image.channels[0]);
        let bytes: &[u8] = bytemuck::cast_slice(values);
        spools.energyscape.write_all(bytes).map_err(|error| spools.energyscape.failure(&error))?;
        let separator = if index == 0 { "\n    " } else { ",\n    " };
        write!(spools.channels, "{separator}{}", channel_summary(channels))
            .map_err(|error| spools.energyscape.failure(&error))?;
        if channels.gains.iter().all(|gain| *gain == 0.0) {
            let input = self.job.target.input.display();
            bar.suspend(|| eprintln!("noctule: {input}: ping {index}: every channel is left out, the image is zero"));
        }
        bar.inc(1);
        Ok(())
    }
}

/// The header of an array of `count` energyscapes.
fn npy_header(count: u64, grid: &PolarGrid) -> Result<Vec<u8>, Failure> {
    let shape = [count, grid.direction_count() as u64, grid.range_count() as u64];
    let mut header = Vec::new();
    npyz::WriteOptions::<f32>::new().default_dtype().shape(&shape).writer(&mut header).begin_nd()?;
    Ok(header)
}

/// Puts the array in its place, with the number of pings that there turned out to be.
fn finish_energyscape(mut file: NewFile, count: u64, grid: &PolarGrid) -> Result<(), Failure> {
    // Headers are padded to 64 bytes, with more room left than a count has digits: the length stays the same.
    file.overwrite_start(&npy_header(count, grid)?)?;
    file.finish()
}

/// Writes the meta data with a line for each ping, which were never in memory together.
fn write_meta(path: &Path, meta: &Value, channels: BufWriter<File>) -> Result<(), Failure> {
    let text = format!("{meta:#}");
    let open = text.trim_end().trim_end_matches('}').trim_end();
    let mut file = NewFile::create(path)?;
    let written = (|| {
        let mut lines = channels.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        lines.rewind()?;
        write!(file, "{open},\n  \"channels\": [")?;
        std::io::copy(&mut lines, &mut file)?;
        file.write_all(b"\n  ]\n}\n")
    })();
    written.map_err(|error| file.failure(&error))?;
    file.finish()
}

/// Removes a file; false when there was none.
fn remove(path: &Path) -> Result<bool, Failure> {
    match std::fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(Failure::new(exit::IO, format!("{}: cannot remove: {error}", path.display()))),
    }
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
