//! `[imaging]` of the configuration.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which backend to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prefer {
    /// A hardware GPU if there is one, else the CPU.
    #[default]
    Auto,
    /// Any adapter, a software one included; an error where there is none.
    Gpu,
    /// The CPU.
    Cpu,
}

/// Weighting of the matched filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// Plain matched filter.
    #[default]
    None,
    /// Phase transform: every bin's magnitude is divided out.
    Phat,
}

/// Directions of interest: equal steps in the horizontal plane, or a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DirectionsParams {
    /// First bearing.
    pub start_deg: f64,
    /// Step between bearings.
    pub step_deg: f64,
    /// Number of bearings.
    pub count: usize,
    /// CSV of `azimuth_deg,elevation_deg` rows instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
}

impl Default for DirectionsParams {
    fn default() -> Self {
        Self { start_deg: -89.5, step_deg: 1.0, count: 180, file: None }
    }
}

/// Range steps that images can have.
pub const RANGE_STEP_M: std::ops::RangeInclusive<f64> = 1e-4..=0.5;
/// Lowest cut-off of the smoothing low-pass.
pub const SMOOTHING_MIN_HZ: f64 = 10.0;

/// `[imaging]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImagingParams {
    /// Which backend to use.
    pub backend: Prefer,
    /// First range.
    pub range_min_m: f64,
    /// Last range.
    pub range_max_m: f64,
    /// Largest distance between range bins; by default the smaller of 5 mm and c / (2.4 bandwidth).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_step_m: Option<f64>,
    /// Directions of interest.
    pub directions: DirectionsParams,
    /// Weighting of the matched filter.
    pub weighting: Weighting,
    /// Cut-off of the smoothing low-pass on the envelope; off when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smoothing_hz: Option<f64>,
}

impl Default for ImagingParams {
    fn default() -> Self {
        Self {
            backend: Prefer::Auto,
            range_min_m: 0.3,
            range_max_m: 5.0,
            range_step_m: None,
            directions: DirectionsParams::default(),
            weighting: Weighting::None,
            smoothing_hz: None,
        }
    }
}
