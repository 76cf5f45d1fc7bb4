//! Where the direct path says that the microphones are, against where the array's geometry says so.
//!
//! In: by how much farther than expected the direct path of each channel seems to be. Out: which channels do not fit the others, and
//! how well the rest fits; after many pings, the emitter's place and the speed of sound that fit best. What all
//! channels share is not judged here: an offset, and a scale, which is the air's temperature. Allocates nothing.

use nalgebra::{Matrix4, Vector3, Vector4};

/// Distance between two shells around the emitter that microphones may be exchanged between without anybody telling: below it the
/// image does not suffer either (a fourteenth of a wavelength at 35 kHz). A real array fitted to 0.6 mm rms.
pub const OUTLIER_MIN_M: f64 = 0.75e-3;
/// A channel that is farther off is an outlier however badly the others fit: four times 0.6 mm.
pub const OUTLIER_MAX_M: f64 = 2.5e-3;
/// Spread of the fitting channels, in standard deviations, within which a channel belongs to them.
const OUTLIER_SPREADS: f64 = 5.0;
/// Rms deviation of the fitting channels above which no array fits: more than twice what a real one had.
pub const RMS_MAX_M: f64 = 1.5e-3;
/// Largest scale that is fitted: the speed of sound is 3 % off for an error of 18 degrees of the air's temperature.
const SCALE_MAX: f64 = 0.05;
/// What is expected of a deviation and of the scale, before anything is measured: keeps the fit sound where all microphones are equally
/// far from the emitter.
const DEVIATION_EXPECTED_M: f64 = 0.6e-3;
const SCALE_EXPECTED: f64 = 0.03;
/// And of the emitter's place.
const EMITTER_EXPECTED_M: f64 = 3e-3;
/// Rounds of fitting, leaving out, and fitting again.
const ROUNDS: usize = 4;
/// Deviations within this are never left out of a fit: finer than any real array.
const INLIER_MIN_M: f64 = 0.2e-3;

/// One channel's direct path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Arrival {
    /// Distance from the emitter by the geometry.
    pub(super) distance_m: f64,
    /// By how much farther it seems.
    pub(super) deviation_m: f64,
    /// Left out of the fit; after the fit: does not belong to the others.
    pub(super) outlier: bool,
}

/// How the channels fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    /// Channels that do not fit the others.
    pub(super) outliers: usize,
    /// Rms deviation of the others.
    pub(super) rms_m: f64,
    /// Relative error of all distances: positive when the sound is slower than configured.
    pub(super) scale: f64,
}

impl Fit {
    /// Whether the channels are where the geometry says. One channel alone that is elsewhere is a bad channel, two are
    /// exchanged.
    pub(super) fn holds(&self) -> bool {
        self.outliers <= 1 && self.rms_m <= RMS_MAX_M
    }
}

/// Fits offset and scale to the arrivals and marks those that do not belong to the others. `sorted` is scratch of their number at least.
pub(super) fn fit(arrivals: &mut [Arrival], sorted: &mut Vec<f64>) -> Fit {
    sorted.clear();
    sorted.extend(arrivals.iter().map(|arrival| arrival.deviation_m));
    let (mut offset_m, mut scale) = (middle(sorted), 0.0);
    let mut spread_m = 0.0;
    for _ in 0..ROUNDS {
        let residual = |arrival: &Arrival| arrival.deviation_m - offset_m - scale * arrival.distance_m;
        sorted.clear();
        sorted.extend(arrivals.iter().map(|arrival| residual(arrival).abs()));
        // 1.48 times the median of the sizes is the standard deviation of what is normally distributed.
        spread_m = 1.48 * middle(sorted);
        let limit_m = (3.0 * spread_m).max(INLIER_MIN_M);
        for arrival in arrivals.iter_mut() {
            // NaN is no inlier.
            arrival.outlier = !(residual(arrival).abs() <= limit_m);
        }
        (offset_m, scale) = line(arrivals);
    }
    let limit_m = (OUTLIER_SPREADS * spread_m).clamp(OUTLIER_MIN_M, OUTLIER_MAX_M);
    let (mut outliers, mut squares_m2) = (0, 0.0);
    for arrival in arrivals.iter_mut() {
        let residual_m = arrival.deviation_m - offset_m - scale * arrival.distance_m;
        arrival.outlier = !(residual_m.abs() <= limit_m);
        if arrival.outlier {
            outliers += 1;
        } else {
            squares_m2 += residual_m * residual_m;
        }
    }
    Fit { outliers, rms_m: (squares_m2 / (arrivals.len() - outliers).max(1) as f64).sqrt(), scale }
}

/// Offset and slope of the line through the arrivals that are not left out.
fn line(arrivals: &[Arrival]) -> (f64, f64) {
    let used = || arrivals.iter().filter(|arrival| !arrival.outlier);
    let count = used().count().max(1) as f64;
    let mean_m = used().map(|arrival| arrival.distance_m).sum::<f64>() / count;
    let mean_deviation_m = used().map(|arrival| arrival.deviation_m).sum::<f64>() / count;
    let (mut along_m2, mut across_m2) = (0.0, (DEVIATION_EXPECTED_M / SCALE_EXPECTED).powi(2));
    for arrival in used() {
        let distance_m = arrival.distance_m - mean_m;
        along_m2 += distance_m * (arrival.deviation_m - mean_deviation_m);
        across_m2 += distance_m * distance_m;
    }
    let scale = (along_m2 / across_m2).clamp(-SCALE_MAX, SCALE_MAX);
    (mean_deviation_m - scale * mean_m, scale)
}

fn middle(sorted: &mut [f64]) -> f64 {
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// What fits the direct paths of many pings best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Pings that it rests on.
    pub pings: u32,
    /// Channels that it rests on.
    pub channels: usize,
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// Place of the emitter in the sensor frame; as configured along x where the array lies in the plane of the emitter, which tells
    /// nothing of it.
    pub emitter_m: Vector3<f64>,
    /// How much later than expected the emission begins.
    pub offset_s: f64,
    /// Rms distance between where the direct path ends and where the array's geometry says that the microphones are.
    pub residual_m: f64,
}

impl std::fmt::Display for Calibration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { pings, channels, speed_of_sound_m_s, emitter_m, offset_s, residual_m } = self;
        let [x_mm, y_mm, z_mm] = [emitter_m.x, emitter_m.y, emitter_m.z].map(|place_m| 1e3 * place_m);
        write!(
            f,
            "the direct path fits the array to {:.2} mm rms on {channels} channels over {pings} pings, with {speed_of_sound_m_s:.1} m/s, \
             the emitter at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm and the emission {:.1} us late",
            1e3 * residual_m,
            1e6 * offset_s
        )
    }
}

/// Fits offset, speed of sound and the emitter's y and z: `heard` yields each microphone's place and mean deviation. `None` with
/// fewer than six.
pub(super) fn calibrate(
    heard: impl Iterator<Item = (Vector3<f64>, f64)> + Clone,
    emitter_m: Vector3<f64>,
    speed_of_sound_m_s: f64,
) -> Option<Calibration> {
    let channels = heard.clone().count();
    if channels < 6 {
        return None;
    }
    // Offset, scale, y, z. Measured distance = offset + (1 + scale) |p - e - shift|.
    let weak = |expected: f64| (DEVIATION_EXPECTED_M / expected).powi(2);
    let priors = Vector4::new(1e-9, weak(SCALE_EXPECTED), weak(EMITTER_EXPECTED_M), weak(EMITTER_EXPECTED_M));
    let mut found = Vector4::zeros();
    let residual = |found: &Vector4<f64>, place_m: &Vector3<f64>, deviation_m: f64| {
        let shifted_m = place_m - emitter_m - Vector3::new(0.0, found[2], found[3]);
        let measured_m = (place_m - emitter_m).norm() + deviation_m;
        (measured_m - found[0] - (1.0 + found[1]) * shifted_m.norm(), shifted_m)
    };
    for _ in 0..ROUNDS {
        let mut normal = Matrix4::from_diagonal(&priors);
        let mut right = -priors.component_mul(&found);
        for (place_m, deviation_m) in heard.clone() {
            let (left_m, shifted_m) = residual(&found, &place_m, deviation_m);
            let distance_m = shifted_m.norm().max(1e-6);
            let stretch = 1.0 + found[1];
            let row =
                Vector4::new(1.0, distance_m, -stretch * shifted_m.y / distance_m, -stretch * shifted_m.z / distance_m);
            normal += row * row.transpose();
            right += row * left_m;
        }
        found += normal.cholesky()?.solve(&right);
    }
    let squares_m2: f64 = heard.map(|(place_m, deviation_m)| residual(&found, &place_m, deviation_m).0.powi(2)).sum();
    Some(Calibration {
        pings: 0,
        channels,
        speed_of_sound_m_s: speed_of_sound_m_s / (1.0 + found[1]),
        emitter_m: emitter_m + Vector3::new(0.0, found[2], found[3]),
        offset_s: found[0] / speed_of_sound_m_s,
        residual_m: (squares_m2 / channels as f64).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::MicrophoneArray;

    const EMITTER_M: Vector3<f64> = Vector3::new(0.0, 0.0, 0.06);

    /// Deviations of the array's channels when `truth` gives the measured distance of each place.
    fn arrivals(truth: impl Fn(usize, Vector3<f64>) -> f64) -> Vec<Arrival> {
        let array = MicrophoneArray::ertis_v3d1();
        let arrival = |(index, place_m): (usize, &Vector3<f64>)| {
            let distance_m = (place_m - EMITTER_M).norm();
            Arrival { distance_m, deviation_m: truth(index, *place_m) - distance_m, outlier: false }
        };
        array.positions_m.iter().enumerate().map(arrival).collect()
    }

    #[test]
    fn a_late_start_and_another_temperature_leave_nothing_and_one_channel_stands_out() {
        let mut all = arrivals(|_, place_m| 4e-3 + 1.03 * (place_m - EMITTER_M).norm());
        let found = fit(&mut all, &mut Vec::new());
        assert!(found.holds() && found.outliers == 0 && found.rms_m < 1e-4, "{found:?}");
        assert!((found.scale - 0.03).abs() < 0.004, "{found:?}");
        let mut all = arrivals(|index, place_m| (place_m - EMITTER_M).norm() + if index == 9 { 1.2e-3 } else { 0.0 });
        let found = fit(&mut all, &mut Vec::new());
        assert_eq!((found.outliers, found.holds(), all[9].outlier), (1, true, true));
    }

    #[test]
    fn exchanged_and_broken_channels_are_counted() {
        let array = MicrophoneArray::ertis_v3d1();
        let exchanged = |index: usize| match index {
            3 => 8,
            8 => 3,
            other => other,
        };
        let mut all = arrivals(|index, _| (array.positions_m[exchanged(index)] - EMITTER_M).norm());
        let found = fit(&mut all, &mut Vec::new());
        assert!(found.outliers == 2 && !found.holds(), "{found:?}");
        let mut all = arrivals(|index, _| if index < 2 { f64::NAN } else { 0.06 });
        assert!(!fit(&mut all, &mut Vec::new()).holds());
        assert_eq!(fit(&mut [], &mut Vec::new()).outliers, 0);
    }

    #[test]
    fn the_emitters_place_and_the_speed_of_sound_are_found_again() {
        let array = MicrophoneArray::ertis_v3d1();
        let truth_m = EMITTER_M + Vector3::new(0.0, 1.5e-3, 0.0);
        let heard = array
            .positions_m
            .iter()
            .map(|place_m| (*place_m, (place_m - truth_m).norm() * 343.0 / 340.0 - (place_m - EMITTER_M).norm()));
        let found = calibrate(heard, EMITTER_M, 343.0).expect("enough channels");
        assert!((found.emitter_m.y - 1.5e-3).abs() < 1e-4, "{found:?}");
        // Height, speed and offset are hard to tell apart; what they leave together is little.
        assert!(found.residual_m < 5e-5, "{found:?}");
        assert!(calibrate([(EMITTER_M, 0.0); 5].into_iter(), EMITTER_M, 343.0).is_none());
    }
}
