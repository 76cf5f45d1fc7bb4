//! From a configuration to the things that work: sensors, plan, masks. The only place where they are put together.

use super::regions;
use crate::config::Config;
use crate::flow::MaskSet;
use crate::imaging::plan::ImagingPlan;
use crate::io::RawShape;
use crate::io::recording_file::FileHints;
use crate::parameter::ParameterError;
use crate::sensor::{RecordingFormat, RecordingParams, SensorSetup};
use crate::signal::SampleFormat;
use std::sync::Arc;

/// The sensors, ready to be imaged.
#[derive(Debug, Clone)]
pub struct SensingSetup {
    /// The sensors, in the order of the plan.
    pub sensors: Vec<SensorSetup>,
    /// The same before a calibration is applied.
    pub uncalibrated: Vec<SensorSetup>,
    /// The plan for all of them.
    pub plan: Arc<ImagingPlan>,
    /// Format of the raw data.
    pub recording: RecordingFormat,
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// What hides which bearings of which sensor, one sentence each.
    pub hidden: Vec<String>,
    /// What was ignored.
    pub warnings: Vec<String>,
}

impl SensingSetup {
    /// The sensors' names, in the order of the plan.
    #[must_use]
    pub fn sensor_names(&self) -> Vec<String> {
        self.sensors.iter().map(|sensor| sensor.name.clone()).collect()
    }

    /// Cells of each sensor's energyscape.
    #[must_use]
    pub fn cell_counts(&self) -> Vec<usize> {
        vec![self.plan.grid.cell_count(); self.sensors.len()]
    }

    /// For each sensor and direction of the grid, whether something hides it.
    #[must_use]
    pub fn hidden_directions(&self) -> Vec<Vec<bool>> {
        self.plan.sensors.iter().map(|sensor| sensor.hidden.clone()).collect()
    }

    /// Each sensor's name and what its raw pings must look like.
    #[must_use]
    pub fn raw_shapes(&self) -> Vec<(String, RawShape)> {
        let shape = |index: usize| RawShape {
            format: self.plan.format,
            sample_rate_hz: self.recording.sample_rate_hz,
            channel_count: self.plan.sensors[index].channel_count,
            sample_count: self.recording.samples,
        };
        self.sensor_names().into_iter().enumerate().map(|(index, name)| (name, shape(index))).collect()
    }
}

/// Plans for all configured sensors.
///
/// # Errors
/// What the configuration asks for and cannot be.
pub fn sensing(config: &Config) -> Result<SensingSetup, ParameterError> {
    let all: Vec<usize> = (0..config.sensor.len()).collect();
    plan(config, &all, &config.recording()?)
}

/// Plans for one sensor alone and for raw data of another format or length; the others still hide what they hide.
///
/// # Errors
/// As [`sensing`].
pub fn sensing_of_one(
    config: &Config,
    sensor_index: usize,
    recording: &RecordingFormat,
) -> Result<SensingSetup, ParameterError> {
    let mut config = config.clone();
    // The emission is made at the demodulated rate, which follows from the recording.
    config.recording = RecordingParams {
        format: recording.format,
        sample_rate_hz: Some(recording.sample_rate_hz),
        samples: Some(recording.samples),
        decimation: Some(recording.decimation),
    };
    plan(&config, &[sensor_index], recording)
}

fn plan(config: &Config, chosen: &[usize], recording: &RecordingFormat) -> Result<SensingSetup, ParameterError> {
    let setups = config.sensor_setups()?;
    let directions = config.directions()?;
    let zones = config.dead_zones(&setups, &directions);
    let mut hidden = Vec::new();
    let mut listed = Vec::new();
    let mut warnings = Vec::new();
    for &index in chosen {
        let (zone, name) = (&zones[index], &setups[index].name);
        hidden.push(zone.hidden.clone());
        listed.extend(zone.listed.iter().map(|what| format!("{name}: {what}")));
        warnings.extend(zone.warnings.iter().map(|what| format!("{name}: {what}")));
    }
    let sensors: Vec<SensorSetup> = chosen.iter().map(|index| setups[*index].clone()).collect();
    // Files are read a second time only where something differs.
    let uncalibrated = if config.calibration.apply.is_empty() {
        sensors.clone()
    } else {
        let nominal = config.uncalibrated().sensor_setups()?;
        chosen.iter().map(|index| nominal[*index].clone()).collect()
    };
    let speed_of_sound_m_s = config.speed_of_sound_m_s();
    let plan = ImagingPlan::new(&sensors, &hidden, recording, &config.imaging, directions, speed_of_sound_m_s)?;
    Ok(SensingSetup {
        sensors,
        uncalibrated,
        plan: Arc::new(plan),
        recording: *recording,
        speed_of_sound_m_s,
        hidden: listed,
        warnings,
    })
}

/// Builds the masks of the configured regions on the plan's grid.
///
/// # Errors
/// A region that no sensor sees, and what [`MaskSet::build`] refuses.
pub fn masks(config: &Config, setup: &SensingSetup) -> Result<MaskSet, ParameterError> {
    let params = regions::mask_params(&config.control, &config.platform, &config.imaging.directions);
    MaskSet::build(&setup.plan.grid, &setup.sensors, &setup.hidden_directions(), &params)
        .map_err(|error| error.within("control"))
}

/// The recording format for a file that holds pings of `format` with `sample_count` words or samples of one channel: what
/// the configuration leaves open is taken from the file, what it says must fit.
///
/// # Errors
/// The key of `[recording]` that does not fit, with what the file has.
pub fn recording_for(
    config: &Config,
    format: SampleFormat,
    sample_count: usize,
) -> Result<RecordingFormat, ParameterError> {
    let mut params = config.recording;
    if params == RecordingParams::default() {
        params.format = format;
    }
    if params.format != format {
        return Err(ParameterError::new("format", format.as_str(), params.format.as_str()));
    }
    if let Some(configured) = params.samples.filter(|configured| *configured != sample_count) {
        return Err(ParameterError::new("samples", sample_count, configured.to_string()));
    }
    params.samples = Some(sample_count);
    params.resolve()
}

/// What the configuration says of recordings whose files do not say it themselves.
#[must_use]
pub fn file_hints(config: &Config) -> FileHints {
    let pcm = config.recording.format != SampleFormat::Pdm;
    let silent = config.recording == RecordingParams::default();
    // Silence means the sensor's own rate. PDM has another rate than a file of PCM, which is refused for its format.
    let rate_hz = || RecordingFormat::of(SampleFormat::PcmF32).sample_rate_hz;
    let configured = pcm.then(|| config.recording.sample_rate_hz.unwrap_or_else(rate_hz));
    FileHints {
        words_per_ping: words_per_ping(config),
        samples_per_ping: config.recording.samples.filter(|_| pcm),
        sample_rate_hz: configured.or_else(|| silent.then(rate_hz)),
    }
}

/// PDM words in a ping, for files that do not say.
fn words_per_ping(config: &Config) -> usize {
    match config.recording.format {
        SampleFormat::Pdm => config.recording.samples,
        SampleFormat::PcmI16 | SampleFormat::PcmF32 => None,
    }
    .unwrap_or(RecordingFormat::of(SampleFormat::Pdm).samples)
}
