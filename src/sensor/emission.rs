//! The FM sweep sent out (specification, section 2).

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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
