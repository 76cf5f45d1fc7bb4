//! The FM sweep sent out (specification, section 2).
//!
//! Goes in: `[emission]` of the configuration and the demodulated sample rate. Comes out: the samples that the matched
//! filter looks for and the band they fill. Directivity and sound pressure are not known here.

use super::emission_plan::{EmissionPlan, Sweeps};
use super::table;
use crate::parameter::{ParameterError, check_positive, check_range};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Longest emission.
const DURATION_MAX_S: f64 = 0.1;
/// Highest frequency of a sweep; what really limits it is the sample rate.
const FREQUENCY_MAX_HZ: f64 = 10e6;
/// Most samples of an emission, so that a high rate and a long sweep cannot fill the memory.
const SAMPLES_MAX: usize = 1 << 20;

/// Form of the sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EmissionShape {
    /// Frequency falls or rises hyperbolically: Doppler tolerant.
    Hyperbolic,
    /// Frequency changes linearly with time.
    Linear,
    /// Samples from a file, at the demodulated sample rate.
    Csv,
}

/// `[emission]` of the configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmissionParams {
    /// Form of the sweep.
    pub shape: EmissionShape,
    /// Frequency at the start. For `csv`, with `end_hz`, the band that the samples occupy.
    pub start_hz: f64,
    /// Frequency at the end.
    pub end_hz: f64,
    /// Duration.
    pub duration_s: f64,
    /// Share of the duration that each end's taper takes, 0 to 0.5.
    pub taper: f64,
    /// File of samples, `csv` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// When the sensors fire.
    pub plan: EmissionPlan,
    /// What they send.
    pub sweeps: Sweeps,
    /// From one sensor's emission to the next one's, in turn only; the shortest that is allowed by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slot_s: Option<f64>,
}

impl Default for EmissionParams {
    fn default() -> Self {
        Self {
            shape: EmissionShape::Hyperbolic,
            start_hz: 50e3,
            end_hz: 25e3,
            duration_s: 2.5e-3,
            taper: 0.1,
            file: None,
            plan: EmissionPlan::Together,
            sweeps: Sweeps::Same,
            slot_s: None,
        }
    }
}

impl EmissionParams {
    /// Judges the values that do not depend on a sample rate or a file.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[emission]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_positive("start_hz", self.start_hz, FREQUENCY_MAX_HZ)?;
        check_positive("end_hz", self.end_hz, FREQUENCY_MAX_HZ)?;
        if self.start_hz == self.end_hz {
            return Err(ParameterError::new("end_hz", self.end_hz, "a frequency other than start_hz: a sweep"));
        }
        check_positive("duration_s", self.duration_s, DURATION_MAX_S)?;
        check_range("taper", self.taper, 0.0, 0.5)?;
        self.validate_plan()?;
        match (self.shape, &self.file) {
            (EmissionShape::Csv, None) => {
                Err(ParameterError::new("file", "nothing", "a CSV file, for shape = \"csv\""))
            }
            (EmissionShape::Hyperbolic | EmissionShape::Linear, Some(file)) => {
                let allowed = "no file, or shape = \"csv\"";
                Err(ParameterError::new("file", format!("{:?}", file.display().to_string()), allowed))
            }
            _ => Ok(()),
        }
    }
}

/// The emitted signal at the demodulated sample rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Emission {
    /// Samples, full scale 1; sample 0 is at time 0.
    pub samples: Vec<f64>,
    /// Their rate.
    pub sample_rate_hz: f64,
    /// Lowest and highest frequency of the sweep.
    pub band_hz: (f64, f64),
}

impl Emission {
    /// The emission that `params` describe, sampled at `sample_rate_hz`; a relative file is looked for in `base_dir`.
    ///
    /// # Errors
    /// As [`EmissionParams::validate`], and what is wrong with the file.
    pub fn new(params: &EmissionParams, sample_rate_hz: f64, base_dir: &Path) -> Result<Self, ParameterError> {
        params.validate()?;
        let count = params.duration_s * sample_rate_hz + 1.0;
        if !(count >= 2.0 && count <= SAMPLES_MAX as f64) {
            let found = format!("{} ({count} samples at {sample_rate_hz} Hz)", params.duration_s);
            return Err(ParameterError::new("duration_s", found, format!("2 to {SAMPLES_MAX} samples")));
        }
        let (start_hz, end_hz) = (params.start_hz, params.end_hz);
        match (params.shape, &params.file) {
            (EmissionShape::Csv, Some(file)) => {
                let path = base_dir.join(file);
                let found = table::read(&path).and_then(|text| {
                    let emission = Self::from_csv(&text, sample_rate_hz, (start_hz.min(end_hz), start_hz.max(end_hz)));
                    emission.map_err(|error| table::in_file(&path, error))
                });
                found.map_err(|error| error.within("file"))
            }
            (EmissionShape::Linear, _) => {
                Ok(Self::linear(start_hz, end_hz, params.duration_s, params.taper, sample_rate_hz))
            }
            _ => Ok(Self::hyperbolic(start_hz, end_hz, params.duration_s, params.taper, sample_rate_hz)),
        }
    }

    /// A sweep whose period changes linearly with time, from `start_hz` to `end_hz`, tapered at both ends.
    #[must_use]
    pub fn hyperbolic(start_hz: f64, end_hz: f64, duration_s: f64, taper: f64, sample_rate_hz: f64) -> Self {
        let slope_s = 1.0 / end_hz - 1.0 / start_hz;
        // ln(1/f0 + t slope/T) - ln(1/f0), in one step so that no digits cancel.
        let phase = |t_s: f64| TAU * duration_s / slope_s * (t_s * slope_s * start_hz / duration_s).ln_1p();
        Self::sweep(phase, (start_hz, end_hz), duration_s, taper, sample_rate_hz)
    }

    /// A sweep whose frequency changes linearly with time, from `start_hz` to `end_hz`, tapered at both ends.
    #[must_use]
    pub fn linear(start_hz: f64, end_hz: f64, duration_s: f64, taper: f64, sample_rate_hz: f64) -> Self {
        let phase = |t_s: f64| TAU * (start_hz * t_s + 0.5 * (end_hz - start_hz) * t_s * t_s / duration_s);
        Self::sweep(phase, (start_hz, end_hz), duration_s, taper, sample_rate_hz)
    }

    fn sweep(
        phase: impl Fn(f64) -> f64,
        (start_hz, end_hz): (f64, f64),
        duration_s: f64,
        taper: f64,
        sample_rate_hz: f64,
    ) -> Self {
        // A whole number of periods, such as 2.5 ms at 450 kHz, may come out a rounding error short.
        let count = (duration_s * sample_rate_hz + 1e-6).floor() as usize + 1;
        let mut samples: Vec<f64> = (0..count).map(|index| phase(index as f64 / sample_rate_hz).sin()).collect();
        let width = (2.0 * taper * count as f64).round() as usize;
        let hann = |k: usize| 0.5 * (1.0 - (TAU * k as f64 / (width + 1) as f64).cos());
        let fade_in = width.div_ceil(2);
        for k in 1..=width.min(count) {
            let index = if k <= fade_in { k - 1 } else { count + k - 1 - width };
            samples[index] *= hann(k);
        }
        Self { samples, sample_rate_hz, band_hz: (start_hz.min(end_hz), start_hz.max(end_hz)) }
    }

    /// Reads one sample a row, either alone or after its index, at `sample_rate_hz`; a header is allowed. `band_hz` is the
    /// band that they fill, lower end first.
    ///
    /// # Errors
    /// Names the line, what was found and what is allowed; the key is empty.
    pub fn from_csv(text: &str, sample_rate_hz: f64, band_hz: (f64, f64)) -> Result<Self, ParameterError> {
        let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or("");
        // A word is a header; "nan" and "inf" are bad samples.
        let first = first.split(',').next().unwrap_or("").trim();
        let has_header = first.starts_with(char::is_alphabetic) && first.parse::<f64>().is_err();
        let (_, rows) = table::rows(text, has_header)?;
        let samples = rows.iter().enumerate().map(|(index, row)| match row.values.as_slice() {
            [sample] => Ok(*sample),
            [number, sample] if *number == index as f64 => Ok(*sample),
            [number, _] => Err(row.refuse(format!("index {number}"), format!("index {index}"))),
            values => Err(row.refuse(format!("{} numbers", values.len()), "a sample, or its index and a sample")),
        });
        let samples = samples.collect::<Result<Vec<f64>, _>>()?;
        if !(2..=SAMPLES_MAX).contains(&samples.len()) {
            let allowed = format!("2 to {SAMPLES_MAX} samples");
            return Err(ParameterError::new("", format!("{} samples", samples.len()), allowed));
        }
        if let Some(row) = rows.iter().zip(&samples).find(|(_, sample)| !(sample.abs() <= 1e6)).map(|(row, _)| row) {
            return Err(row.refuse("a sample beyond 1e6", "samples in units of full scale, 1"));
        }
        if samples.iter().all(|sample| *sample == 0.0) {
            return Err(ParameterError::new("", "silence", "at least one sample other than 0"));
        }
        Ok(Self { samples, sample_rate_hz, band_hz })
    }

    /// Time from the first to the last sample.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        (self.samples.len() - 1) as f64 / self.sample_rate_hz
    }
}
