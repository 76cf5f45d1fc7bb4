//! Near ranges focused on their exact path (specification, section 3, "far field by default", beyond it): sizes and tables.
//!
//! An echo from the point r u reaches the microphone at p after |r u - e| + |r u - p|, e being the emitter. The plane wave of the
//! specification takes 2 r - p.u for it. What lacks, the *excess* over 2 r, is applied to the matched-filtered channel signals
//! themselves: complex basebands a little faster than the band, read between their samples by a least-squares interpolator
//! (Laakso et al. 1996, "Splitting the unit delay"). One excess serves a *block* of ranges, short enough that it is right
//! for all of them within [`PHASE_ERROR_MAX_DEG`]. In: what the plan knows. Out: [`FocusPlan`]. Never touches a sample.

use super::clean::{self, CleanPlan};
use super::combine::Combine;
use super::sizes::is_smooth;
use super::{Band, ImagingPlan};
use crate::imaging::params::ImagingParams;
use crate::parameter::ParameterError;
use crate::sensor::SensorSetup;
use nalgebra::{DMatrix, DVector, Vector3};

/// Taps of the interpolator. With a rate [`RATE_PER_WIDTH_MIN`] times the band its rms error is 1.5e-5, a seventh of the accuracy asked for.
pub const TAPS: usize = 10;
/// Steps of a sample for which the taps are tabled; between two of them they are interpolated, which adds 4e-6.
pub const FRACTIONS: usize = 256;
/// Values of a row of the table: taps and zeros, three vectors of four.
pub const TAP_ROW: usize = 12;
/// Taps before the sample itself.
pub const TAPS_BEFORE: usize = TAPS / 2 - 1;
/// Least rate of the channel signals over the band's width, edges included.
const RATE_PER_WIDTH_MIN: f64 = 2.2;
/// Lengths that a block may have, whole vectors first.
const BLOCK_LENS: [usize; 8] = [64, 48, 32, 16, 8, 4, 2, 1];
/// Lanes of the longest vector.
const VECTOR_LEN: usize = 16;
/// Samples that the longest vector may read beyond a block.
const OVERRUN: usize = 64;
/// Phase at the band's upper edge by which the excess may be wrong within a block: 0.03 dB of a beam's peak.
const PHASE_ERROR_MAX_DEG: f64 = 15.0;
/// Range by which it may be wrong.
const RANGE_ERROR_MAX_M: f64 = 5e-4;
/// Plane waves are used from where the outermost microphone is out of phase by less, at the band's upper edge: a beam's peak has then
/// lost a tenth of a decibel ...
const PLANE_WAVE_PHASE_DEG: f64 = 45.0;
/// ... and from where the emitter's distance from the origin displaces echoes by less.
const PLANE_WAVE_RANGE_M: f64 = 1.5e-3;

/// What the focused ranges need beside the plan.
#[derive(Debug, Clone)]
pub struct FocusPlan {
    /// The first so many ranges are focused.
    pub range_count: usize,
    /// Ranges that share an excess, one block after another.
    pub blocks: Vec<FocusBlock>,
    /// Samples of a channel signal from one range to the next.
    pub oversampling: usize,
    /// What is made of the aligned channels.
    pub combine: Combine,
    /// What is taken out of them before, if anything.
    pub clean: Option<CleanPlan>,
    /// Length of the transform that makes a channel signal: oversampling times M.
    pub signal_len: usize,
    /// Bin that becomes frequency zero.
    pub centre_bin: usize,
    /// Samples of a row, one of `oversampling` for every channel: row p holds samples p, p + oversampling ...
    pub row_len: usize,
    /// Samples of a row before the one of range 0.
    pub lead: usize,
    /// Samples a metre of path.
    pub samples_per_m: f64,
    /// Turns of the centre frequency a metre of path.
    pub turns_per_m: f64,
    /// `[fraction]`: taps for a delay of so many `FRACTIONS` of a sample, and zeros.
    pub taps: Vec<[f32; TAP_ROW]>,
    /// What differs between sensors.
    pub sensors: Vec<SensorFocus>,
}

/// Ranges that share an excess.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocusBlock {
    /// First range.
    pub first: usize,
    /// How many.
    pub len: usize,
    /// The range whose excess they have: the harmonic mean of the first and the last, since the excess changes as 1 / r.
    pub range_m: f64,
}

/// What differs between sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorFocus {
    /// `[direction][channel]`: p.u in metres.
    pub along_m: Vec<f32>,
    /// `[channel]`: |p|^2.
    pub square_m2: Vec<f32>,
    /// `[direction]`: e.u.
    pub emitter_along_m: Vec<f32>,
    /// e, and |e|^2.
    pub emitter_m: [f32; 3],
    /// See `emitter_m`.
    pub emitter_square_m2: f32,
}

impl FocusPlan {
    /// |r u - p| - r for p.u and |p|^2: how much farther than the range it is to a point beside the origin. Written without the
    /// difference of large numbers, so that `f32` is enough (4e-9 m).
    #[must_use]
    pub fn excess_m(range_m: f32, along_m: f32, square_m2: f32) -> f32 {
        let bend = square_m2 - 2.0 * range_m * along_m;
        bend / ((range_m * range_m + bend).max(0.0).sqrt() + range_m).max(f32::MIN_POSITIVE)
    }
}

/// Range from which plane waves are as good: see the constants.
fn plane_wave_from_m(sensors: &[SensorSetup], band: &Band, speed_of_sound_m_s: f64) -> f64 {
    let one = |sensor: &SensorSetup| {
        let aperture_m = radius_m(sensor);
        let by_phase = 180.0 / PLANE_WAVE_PHASE_DEG * aperture_m.powi(2) * band.high_hz / speed_of_sound_m_s;
        let by_range = sensor.emitter_m.norm_squared() / (4.0 * PLANE_WAVE_RANGE_M);
        by_phase.max(by_range)
    };
    sensors.iter().map(one).fold(0.0, f64::max)
}

/// Distance of the outermost microphone in use from the origin.
fn radius_m(sensor: &SensorSetup) -> f64 {
    let used = sensor.array.positions_m.iter().zip(&sensor.array.enabled).filter(|(_, enabled)| **enabled);
    used.map(|(place, _)| place.norm()).fold(0.0, f64::max)
}

/// The focus of a plan that is otherwise made, or none where no range is to be focused.
///
/// # Errors
/// As [`Combine::new`] and [`clean::rounds`], and where no transform length exists.
pub(super) fn focus(
    plan: &ImagingPlan,
    sensors: &[SensorSetup],
    params: &ImagingParams,
    bands: &[Band],
    speed_of_sound_m_s: f64,
) -> Result<Option<FocusPlan>, ParameterError> {
    let band = &Band::around(bands);
    let combine = Combine::new(params)?;
    let rounds = clean::rounds(params, combine.is_sum())?;
    let to_m = match params.focus_to_m {
        _ if !combine.is_sum() || rounds > 0 => f64::INFINITY,
        Some(to_m) => to_m,
        None if params.smoothing_hz.is_some() => 0.0,
        None => plane_wave_from_m(sensors, band, speed_of_sound_m_s),
    };
    let grid = &plan.grid;
    let near = (0..grid.range_count()).take_while(|range| grid.range_m(*range) <= to_m).count();
    if near == 0 || to_m == 0.0 {
        return Ok(None);
    }
    let blocks = blocks(plan, sensors, band, speed_of_sound_m_s, near);
    let range_count = blocks.last().map_or(0, |block| block.first + block.len);
    let oversampling = oversampling(plan, band)?;
    let signal_len = oversampling * plan.inverse_len;
    // A transform over bins of `bin_step_hz`: so many samples a second.
    let rate_hz = signal_len as f64 * plan.bin_step_hz;
    let samples_per_m = rate_hz / speed_of_sound_m_s;
    let reach_m = sensors.iter().map(|s| radius_m(s) + s.emitter_m.norm()).fold(0.0, f64::max);
    let lead = ((reach_m * samples_per_m) as usize + TAPS).div_ceil(oversampling) + 1 + combine.reach();
    let centre_bin = plan.first_bin + plan.bin_count / 2;
    let mut focus = FocusPlan {
        range_count,
        blocks,
        oversampling,
        combine,
        clean: None,
        signal_len,
        centre_bin,
        row_len: 2 * lead + range_count + OVERRUN,
        lead,
        samples_per_m,
        turns_per_m: centre_bin as f64 * plan.bin_step_hz / speed_of_sound_m_s,
        taps: interpolator(band.width_hz() / rate_hz),
        sensors: sensors.iter().map(|sensor| sensor_focus(plan, sensor)).collect(),
    };
    focus.clean = (rounds > 0).then(|| clean::clean(plan, &focus, sensors, bands, rounds, speed_of_sound_m_s));
    Ok(Some(focus))
}

fn sensor_focus(plan: &ImagingPlan, sensor: &SensorSetup) -> SensorFocus {
    let units: Vec<Vector3<f64>> = plan.grid.directions().iter().map(crate::signal::Direction::unit).collect();
    let places = &sensor.array.positions_m;
    SensorFocus {
        along_m: units.iter().flat_map(|unit| places.iter().map(|place| place.dot(unit) as f32)).collect(),
        square_m2: places.iter().map(|place| place.norm_squared() as f32).collect(),
        emitter_along_m: units.iter().map(|unit| sensor.emitter_m.dot(unit) as f32).collect(),
        emitter_m: [0, 1, 2].map(|axis| sensor.emitter_m[axis] as f32),
        emitter_square_m2: sensor.emitter_m.norm_squared() as f32,
    }
}

/// Smallest number of samples a range step that is fast enough and has a transform.
fn oversampling(plan: &ImagingPlan, band: &Band) -> Result<usize, ParameterError> {
    let step_rate_hz = plan.inverse_len as f64 * plan.bin_step_hz;
    let least = (RATE_PER_WIDTH_MIN * band.width_hz() / step_rate_hz).ceil().max(1.0) as usize;
    (least..2 * least + 2).find(|count| is_smooth(*count)).ok_or_else(|| {
        ParameterError::new(
            "imaging.range_step_m",
            plan.grid.range_step_m(),
            "a step for which a transform length exists",
        )
    })
}

/// Cuts the ranges into blocks, each as long as its excess is right for all of it.
fn blocks(
    plan: &ImagingPlan,
    sensors: &[SensorSetup],
    band: &Band,
    speed_of_sound_m_s: f64,
    near: usize,
) -> Vec<FocusBlock> {
    let grid = &plan.grid;
    // The excess changes as 1 / r; half of the change to either side of the block's own range.
    let bend_max = sensors.iter().map(|sensor| {
        let phase_deg = 90.0 * radius_m(sensor).powi(2) * band.high_hz / speed_of_sound_m_s;
        (PHASE_ERROR_MAX_DEG / phase_deg).min(8.0 * RANGE_ERROR_MAX_M / sensor.emitter_m.norm_squared())
    });
    let bend_max = bend_max.fold(f64::INFINITY, f64::min);
    let mut blocks = Vec::new();
    let mut first = 0;
    while first < near {
        let near_m = grid.range_m(first);
        let fits = |len: &usize| {
            let last_m = grid.range_m(first + len - 1);
            // No farther than asked for, but whole vectors.
            let wanted = first + len <= near.next_multiple_of(VECTOR_LEN) || *len <= VECTOR_LEN;
            *len == 1 || (wanted && near_m > 0.0 && 1.0 / near_m - 1.0 / last_m <= bend_max)
        };
        let len = BLOCK_LENS.into_iter().find(fits).unwrap_or(1).min(grid.range_count() - first);
        let far_m = grid.range_m(first + len - 1);
        let range_m = if near_m > 0.0 { 2.0 * near_m * far_m / (near_m + far_m) } else { 0.5 * far_m };
        blocks.push(FocusBlock { first, len, range_m });
        first += len;
    }
    blocks
}

/// Taps that read a signal of `width` cycles a sample about zero frequency between its samples: least squares over that band.
fn interpolator(width: f64) -> Vec<[f32; TAP_ROW]> {
    let sinc = |x: f64| {
        let angle = std::f64::consts::PI * width * x;
        if angle.abs() < 1e-9 { 1.0 } else { angle.sin() / angle }
    };
    let place = |tap: usize| tap as f64 - TAPS_BEFORE as f64;
    // A trace of noise keeps the system solvable where the band is narrow.
    let system = DMatrix::from_fn(TAPS, TAPS, |row, column| {
        sinc(place(row) - place(column)) + if row == column { 1e-12 } else { 0.0 }
    });
    let factors = system.lu();
    (0..=FRACTIONS)
        .map(|fraction| {
            let at = fraction as f64 / FRACTIONS as f64;
            let wanted = DVector::from_fn(TAPS, |row, _| sinc(place(row) - at));
            let solved = factors.solve(&wanted).unwrap_or(wanted);
            std::array::from_fn(|tap| solved.get(tap).map_or(0.0, |value| *value as f32))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interpolator_reads_every_frequency_of_the_band_between_samples() {
        let width = 1.0 / RATE_PER_WIDTH_MIN;
        let taps = interpolator(width);
        let mut square = 0.0;
        let mut worst: f64 = 0.0;
        let mut count = 0;
        for step in 0..=100 {
            let frequency = width * (f64::from(step) / 100.0 - 0.5);
            for eighth in 0..=8 * FRACTIONS {
                // Between two rows of the table, too.
                let at = eighth as f64 / 8.0;
                let (row, share) =
                    ((at as usize).min(FRACTIONS - 1), (at - (at as usize).min(FRACTIONS - 1) as f64) as f32);
                let turn = 2.0 * std::f64::consts::PI * frequency;
                let (mut re, mut im) = (-(turn * at / FRACTIONS as f64).cos(), -(turn * at / FRACTIONS as f64).sin());
                for (tap, (here, next)) in taps[row].iter().zip(&taps[row + 1]).enumerate().take(TAPS) {
                    let value = f64::from(here + share * (next - here));
                    let (sin, cos) = (turn * (tap as f64 - TAPS_BEFORE as f64)).sin_cos();
                    (re, im) = (re + value * cos, im + value * sin);
                }
                (square, worst, count) = (square + re * re + im * im, worst.max(re.hypot(im)), count + 1);
            }
        }
        let rms = (square / f64::from(count)).sqrt();
        // Measured 1.4e-5 and 7e-5, the latter at the edge of the band, where the passband is nearly closed.
        assert!(rms < 2e-5 && worst < 1e-4, "{rms:e} {worst:e}");
    }

    #[test]
    fn the_excess_is_that_of_the_exact_path() {
        for (range_m, along_m, square_m2) in
            [(0.3_f64, 0.03, 0.0016), (5.0, -0.06, 0.0036), (0.05, 0.02, 0.0036), (0.0, 0.01, 0.0025)]
        {
            let exact = (range_m * range_m - 2.0 * range_m * along_m + square_m2).sqrt() - range_m;
            let found = f64::from(FocusPlan::excess_m(range_m as f32, along_m as f32, square_m2 as f32));
            assert!((found - exact).abs() < 1e-8, "{found} {exact}");
        }
    }
}
