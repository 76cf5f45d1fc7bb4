//! FIR designs of the plan, in f64: windowed-sinc low-passes and the Gaussian that smooths an envelope.
//!
//! In: band edges and an attenuation. Out: taps of odd length, symmetric about the middle one. Kaiser's window and his
//! formulas for its length and shape. Applies nothing: the backends do.

use std::f64::consts::PI;

/// Modified Bessel function of the first kind and order zero, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let quarter = 0.25 * x * x;
    let (mut term, mut sum, mut n) = (1.0, 1.0, 1.0);
    while term > 1e-17 * sum {
        term *= quarter / (n * n);
        sum += term;
        n += 1.0;
    }
    sum
}

/// Odd number of taps that a Kaiser window needs for `attenuation_db` and a transition of `width`, a share of the sample rate.
pub(super) fn kaiser_length(attenuation_db: f64, width: f64) -> usize {
    let order = (attenuation_db - 7.95) / (14.36 * width);
    2 * (0.5 * order).ceil() as usize + 1
}

/// Low-pass of unit gain at DC: flat up to `pass`, at least `attenuation_db` (above 50) down from `stop` on, both shares of the
/// sample rate.
pub(super) fn low_pass(pass: f64, stop: f64, attenuation_db: f64) -> Vec<f64> {
    let length = kaiser_length(attenuation_db, stop - pass);
    let half = (length / 2) as f64;
    let cutoff = 0.5 * (pass + stop);
    let beta = 0.1102 * (attenuation_db - 8.7);
    let mut taps: Vec<f64> = (0..length)
        .map(|index| {
            let n = index as f64 - half;
            let x = 2.0 * cutoff * n;
            let sinc = if n == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) };
            let place = n / (half + 1.0);
            sinc * bessel_i0(beta * (1.0 - place * place).sqrt())
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|tap| *tap /= sum);
    taps
}

/// Gaussian of unit sum, 3 dB down at `cutoff`, a share of the sample rate. A Gaussian because its taps are all positive: a smoothed
/// envelope stays one.
pub(super) fn gaussian(cutoff: f64) -> Vec<f64> {
    let sigma = 2.0_f64.ln().sqrt() / (2.0 * PI * cutoff);
    let half = (4.5 * sigma).ceil() as i64;
    let mut taps: Vec<f64> = (-half..=half).map(|n| (-0.5 * (n as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|tap| *tap /= sum);
    taps
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain of symmetric taps at a share of the sample rate.
    fn gain(taps: &[f64], frequency: f64) -> f64 {
        let half = (taps.len() / 2) as f64;
        taps.iter().enumerate().map(|(i, tap)| tap * (2.0 * PI * frequency * (i as f64 - half)).cos()).sum()
    }

    #[test]
    fn a_low_pass_is_flat_below_its_edge_and_down_beyond_it() {
        for (pass, stop) in [(0.0117, 0.0883), (0.0333, 0.0917), (0.1, 0.12)] {
            let taps = low_pass(pass, stop, 110.0);
            assert_eq!(taps.len() % 2, 1);
            for step in 0..=200 {
                let share = f64::from(step) / 200.0;
                let ripple = (gain(&taps, pass * share) - 1.0).abs();
                assert!(ripple < 1e-5, "ripple {ripple:e}");
                let leak = gain(&taps, stop + (0.5 - stop) * share).abs();
                assert!(leak < 1e-5, "leak {leak:e}"); // -100 dB: Kaiser's formula is up to 7 dB short for few taps
            }
        }
    }

    #[test]
    fn a_gaussian_is_3_db_down_at_its_cutoff_and_never_negative() {
        let taps = gaussian(0.05);
        assert!((gain(&taps, 0.05) - 0.5_f64.sqrt()).abs() < 1e-4);
        assert!(taps.iter().all(|tap| *tap > 0.0));
    }
}
