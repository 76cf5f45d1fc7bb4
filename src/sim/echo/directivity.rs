//! How much an emitter sends and a microphone hears towards a bearing.
//!
//! The emitter is a circular piston in a baffle (Kuc and Siegel, eq. 1: 2 J1(x)/x with x = k a sin(bearing)); the housing
//! ends the view of both smoothly around a right angle. Amplitudes relative to boresight.

use std::f64::consts::PI;

/// Amplitude of a piston of `radius_m` towards `bearing_rad` at wave number `wave_number_rad_m`.
pub(super) fn piston(radius_m: f64, wave_number_rad_m: f64, bearing_rad: f64) -> f64 {
    let x = wave_number_rad_m * radius_m * bearing_rad.sin();
    // 2 J1(x)/x as its power series; exact enough for x up to 20 (a piston of 14 mm at 80 kHz).
    let quarter = 0.25 * x * x;
    let mut term = 1.0;
    let mut sum = 1.0;
    for order in 1..60 {
        term *= -quarter / (f64::from(order) * f64::from(order + 1));
        sum += term;
        if term.abs() < 1e-16 {
            break;
        }
    }
    sum
}

/// Gain of the housing towards `bearing_rad`: 1 up to `full_rad`, 0 from `zero_rad`, a raised cosine between.
pub(super) fn view(bearing_rad: f64, full_rad: f64, zero_rad: f64) -> f64 {
    let off_axis_rad = bearing_rad.abs();
    if off_axis_rad <= full_rad {
        1.0
    } else if off_axis_rad < zero_rad {
        0.5 + 0.5 * (PI * (off_axis_rad - full_rad) / (zero_rad - full_rad)).cos()
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_piston_has_its_first_null_at_3_8317_and_its_side_lobe_at_minus_17_6_db() {
        assert!(piston(1.0, 3.831_705_970, PI / 2.0).abs() < 1e-9);
        let side_lobe_db = 20.0 * piston(1.0, 5.135_622_302, PI / 2.0).abs().log10();
        assert!((side_lobe_db + 17.57).abs() < 0.01, "{side_lobe_db}");
        assert_eq!(piston(1.0, 5.0, 0.0), 1.0);
    }

    #[test]
    fn nothing_is_heard_from_behind_and_half_at_the_middle_of_the_edge() {
        assert_eq!(view(-1.2, 1.4, 1.74), 1.0);
        assert!((view(1.57, 1.4, 1.74) - 0.5).abs() < 1e-12);
        assert_eq!(view(2.0, 1.4, 1.74), 0.0);
        assert_eq!(view(1.4, 1.4, 1.4), 1.0);
    }
}
