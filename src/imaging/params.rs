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

/// What is made of the channels of a cell once they are aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Beamformer {
    /// Their sum.
    #[default]
    DelayAndSum,
    /// The sum of the products of `multiply_order` different ones, each with its root for amplitude (Matrone et al. 2015, "The delay multiply
    /// and sum beamforming algorithm in ultrasound B-mode medical imaging", IEEE TMI 34; Shen and Hsieh 2019 in the baseband).
    DelayMultiplyAndSum,
    /// The weighted sum of least power that keeps the cell's own echo, in sub-bands, with diagonal loading (Capon 1969): the reference for
    /// quality, twenty times the work.
    MinimumVariance,
}

/// Weights of the microphones, beside those that are switched off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Apodization {
    /// All alike.
    #[default]
    Uniform,
    /// Those of least power beside the main lobe for this array, band and grid.
    LowSideLobes,
}

/// Factor on the amplitude of a cell, 1 where the aligned channels agree, towards 0 where they do not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coherence {
    /// None.
    #[default]
    None,
    /// Power of the sum over the sum of the powers times their number (Mallart and Fink 1994, JASA 96).
    Amplitude,
    /// 1 - sqrt(1 - |mean of the channels' phasors|^2) (Camacho and Fritsch 2011, "Phase coherence imaging of grained materials", IEEE TUFFC 58).
    Phase,
    /// 1 - sqrt(1 - (mean of the channels' signs)^2), a sign being that of the part in phase with the sum (Camacho et al. 2009, "Phase
    /// coherence imaging", IEEE TUFFC 56).
    Sign,
}

/// Directions of interest: equal steps in the horizontal plane, equal areas over the front hemisphere, or a file.
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
    /// So many directions of equal solid angle over the front hemisphere instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub equal_area: Option<usize>,
    /// Of these, only the ones from this elevation to that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<[f64; 2]>,
}

impl Default for DirectionsParams {
    fn default() -> Self {
        Self { start_deg: -89.5, step_deg: 1.0, count: 180, file: None, equal_area: None, elevation_deg: None }
    }
}

impl DirectionsParams {
    /// Cells of an equal-area grid of the hemisphere whose sum over an echo is that of the level fan of 1 degree, with the built-in
    /// array: a cell is then as large as 1 degree times 37, the height of what such an array hears of an echo. Measured with pillars,
    /// bars and balls, 540 to 630 but for what a fan takes for its own height and a grid does not.
    const CELLS_LIKE_A_FAN: f64 = 560.0;

    /// What a cell of the image counts in the sum of a region: 1 on a fan or a list of directions, on an equal-area grid by its
    /// area, so that thresholds hold for any number of directions.
    #[must_use]
    pub fn cell_weight(&self) -> f32 {
        self.equal_area.map_or(1.0, |count| (Self::CELLS_LIKE_A_FAN / count as f64) as f32)
    }
}

/// Range steps that images can have.
pub const RANGE_STEP_M: std::ops::RangeInclusive<f64> = 1e-4..=0.5;
/// Lowest cut-off of the smoothing low-pass.
pub const SMOOTHING_MIN_HZ: f64 = 10.0;

/// Farthest range that can be asked to be focused.
pub const FOCUS_TO_MAX_M: f64 = 1000.0;
/// Most rounds of CLEAN: there is nothing left to take out of a room after fewer.
pub const CLEAN_ROUNDS_MAX: usize = 16;

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
    /// Ranges up to this one are focused on the exact path from the emitter and to every microphone, farther ones take echoes for plane
    /// waves; 0 focuses none. By default as far as it makes a difference (0.7 m for the built-in array), none with smoothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_to_m: Option<f64>,
    /// What is made of the aligned channels. Anything but the plain sum is done cell by cell, at every range on the exact path.
    pub beamformer: Beamformer,
    /// Channels multiplied with one another, 2 to 5; 2 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub multiply_order: Option<usize>,
    /// Factor on the amplitude.
    pub coherence: Coherence,
    /// Weights of the microphones.
    pub apodization: Apodization,
    /// Rounds of CLEAN, 1 to 16: how often the strongest echoes are taken out with their side lobes, to be put back without. Off when
    /// absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clean_rounds: Option<usize>,
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
            focus_to_m: None,
            beamformer: Beamformer::DelayAndSum,
            multiply_order: None,
            coherence: Coherence::None,
            apodization: Apodization::Uniform,
            clean_rounds: None,
        }
    }
}
