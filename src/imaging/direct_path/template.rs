//! What a channel is compared with: the emission as an analytic signal, thinned to a few samples a period.
//!
//! In: the emission. Out: complex correlations of it with the thinned start of a channel at any whole lag. The thinned emission
//! is kept in one part for each place that the grid of the thinned samples can have within it, so that no lag needs
//! other samples. Knows no array and judges nothing.

use crate::sensor::Emission;
use rustfft::{FftPlanner, num_complex::Complex};
use std::f64::consts::TAU;

/// Partial sums of a correlation, so that the compiler may use vector instructions without reordering a single sum.
pub(super) const LANES: usize = 16;
/// Thinned samples a period of the band's upper end, at least: an inner product over instants needs no more than to tell the
/// emission from its mirror image.
const SAMPLES_A_PERIOD: f64 = 3.0;
/// Error of a sample rate that has to be found.
const RATE_ERROR: f64 = 0.01;
/// Lag, in units of the emission's rms bandwidth in radians, at which the correlation is compared with its peak.
const FLANK: f64 = 0.8;

/// The thinned analytic emission.
#[derive(Debug, Clone)]
pub(super) struct Template {
    /// Every so many samples one is used.
    pub(super) stride: usize,
    /// Samples of the emission before thinning.
    pub(super) len: usize,
    /// Energy-weighted mean frequency, in radians a sample.
    pub(super) mean_rad: f64,
    /// Lag at which the correlation has fallen by about a third, samples.
    pub(super) flank: i64,
    /// How much later, in samples, an emission seems to be that was recorded at a rate 1 % off: the larger of the two signs.
    pub(super) rate_shift: f64,
    parts: Vec<Part>,
}

#[derive(Debug, Clone)]
struct Part {
    real: Vec<f32>,
    imaginary: Vec<f32>,
    norm: f32,
}

/// A correlation with the emission at one lag.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Correlation {
    /// Complex inner product.
    pub(super) product: Complex<f32>,
    /// Its size over the norms of both: 0 to 1. NaN or 0 for silence and broken samples.
    pub(super) coefficient: f32,
    /// Amplitude of the emission in the channel.
    pub(super) amplitude: f32,
}

impl Template {
    pub(super) fn new(emission: &Emission) -> Self {
        let upper = emission.band_hz.1 / emission.sample_rate_hz;
        let stride = ((1.0 / (SAMPLES_A_PERIOD * upper)).floor() as usize).clamp(1, 64);
        let (analytic, mean_rad, spread_rad) = analytic(&emission.samples);
        let part = |phase: usize| {
            let thinned = || analytic.iter().skip(phase).step_by(stride);
            Part {
                real: thinned().map(|value| value.re as f32).collect(),
                imaginary: thinned().map(|value| value.im as f32).collect(),
                norm: thinned().map(|value| value.re * value.re).sum::<f64>().sqrt() as f32,
            }
        };
        let flank = flank(spread_rad);
        Self {
            stride,
            len: analytic.len(),
            mean_rad,
            flank,
            rate_shift: rate_shift(&analytic, 4 * flank),
            parts: (0..stride).map(part).collect(),
        }
    }

    /// Correlation of the thinned `start` of a channel with the emission at `lag` samples; nothing where it does not fit in.
    pub(super) fn correlate(&self, start: &[f32], lag: i64) -> Correlation {
        let Ok(lag) = usize::try_from(lag) else { return Correlation::default() };
        let first = lag.div_ceil(self.stride);
        let part = &self.parts[first * self.stride - lag];
        let Some(heard) = start.get(first..first + part.real.len()) else { return Correlation::default() };
        let (real, imaginary, energy) = products(heard, &part.real, &part.imaginary);
        let size = real.hypot(imaginary);
        let norm = energy.sqrt() * part.norm;
        let coefficient = if norm > 0.0 && norm.is_finite() { size / norm } else { 0.0 };
        // The emission's own quadrature turns with the conjugate.
        let product = Complex::new(real, -imaginary);
        Correlation { product, coefficient, amplitude: size / (part.norm * part.norm) }
    }

    /// Thinned samples of a start that holds the emission up to `last_lag`.
    pub(super) fn start_len(&self, last_lag: usize) -> usize {
        last_lag.div_ceil(self.stride) + self.len.div_ceil(self.stride) + 1
    }
}

/// <x, a>, <x, b> and <x, x>.
fn products(x: &[f32], a: &[f32], b: &[f32]) -> (f32, f32, f32) {
    let mut sums = [[0.0_f32; LANES]; 3];
    let chunks = x.chunks_exact(LANES);
    let done = x.len() - chunks.remainder().len();
    for ((x, a), b) in chunks.zip(a.chunks_exact(LANES)).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[0][lane] += x[lane] * a[lane];
            sums[1][lane] += x[lane] * b[lane];
            sums[2][lane] += x[lane] * x[lane];
        }
    }
    let mut totals = sums.map(|lanes| lanes.iter().sum::<f32>());
    for ((x, a), b) in x[done..].iter().zip(&a[done..]).zip(&b[done..]) {
        totals[0] += x * a;
        totals[1] += x * b;
        totals[2] += x * x;
    }
    (totals[0], totals[1], totals[2])
}

/// Lag, in samples, at which the correlation of an emission of this rms bandwidth has fallen by about a third.
pub(crate) fn flank(spread_rad: f64) -> i64 {
    (FLANK / spread_rad.max(1e-3)).round().max(1.0) as i64
}

/// Place of the envelope's peak between its sizes a flank before, at and a flank after a lag, in flanks; at most one.
pub(crate) fn peak_in_flanks([early, middle, late]: [f64; 3]) -> f64 {
    let bend = early + late - 2.0 * middle;
    // Without a peak in between it is farther away than the flank.
    let vertex = if bend < 0.0 { 0.5 * (early - late) / bend } else { (late - early).signum() };
    vertex.clamp(-1.0, 1.0)
}

/// The analytic signal, its mean frequency and its rms bandwidth, radians a sample.
pub(crate) fn analytic(samples: &[f64]) -> (Vec<Complex<f64>>, f64, f64) {
    let len = (2 * samples.len()).next_power_of_two();
    let mut planner = FftPlanner::<f64>::new();
    let mut spectrum = vec![Complex::new(0.0, 0.0); len];
    spectrum.iter_mut().zip(samples).for_each(|(bin, sample)| bin.re = *sample);
    planner.plan_fft_forward(len).process(&mut spectrum);
    let (mut power, mut first, mut second) = (0.0, 0.0, 0.0);
    for (index, bin) in spectrum.iter_mut().enumerate() {
        let rad = TAU * index as f64 / len as f64;
        if index == 0 || index > len / 2 {
            *bin = Complex::new(0.0, 0.0);
            continue;
        }
        *bin *= 2.0 / len as f64;
        power += bin.norm_sqr();
        first += rad * bin.norm_sqr();
        second += rad * rad * bin.norm_sqr();
    }
    planner.plan_fft_inverse(len).process(&mut spectrum);
    spectrum.truncate(samples.len());
    let mean_rad = first / power;
    (spectrum, mean_rad, (second / power - mean_rad * mean_rad).max(0.0).sqrt())
}

/// Lag at which the emission, recorded at a rate 1 % too high and too low, correlates best with itself: the larger size.
fn rate_shift(analytic: &[Complex<f64>], reach: i64) -> f64 {
    let shift = |scale: f64| {
        let at = |place: f64| {
            let (index, part) = (place.floor(), place.fract());
            let sample = |index: f64| analytic.get(index as usize).copied().unwrap_or_default();
            // A straight line between samples is enough to find a broad peak; the carrier is turned along with it.
            sample(index) * (1.0 - part) + sample(index + 1.0) * part
        };
        let size = |lag: i64| {
            let at_lag = |(index, value): (usize, &Complex<f64>)| {
                let place = (index as i64 + lag) as f64 * scale;
                if place < 0.0 { Complex::default() } else { at(place) * value.conj() }
            };
            analytic.iter().enumerate().step_by(4).map(at_lag).sum::<Complex<f64>>().norm()
        };
        let best = (-reach..=reach).max_by(|a, b| size(*a).total_cmp(&size(*b)));
        best.unwrap_or(0).abs() as f64
    };
    shift(1.0 + RATE_ERROR).max(shift(1.0 - RATE_ERROR))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_emission_is_heard_at_its_lag_with_the_phase_of_what_is_left() {
        let emission = Emission::hyperbolic(50e3, 25e3, 2.5e-3, 0.1, 450e3);
        let template = Template::new(&emission);
        assert_eq!(template.stride, 3);
        let mut row = vec![0.0_f32; 2000];
        row[101..].iter_mut().zip(&emission.samples).for_each(|(value, sample)| *value = 0.5 * *sample as f32);
        let start: Vec<f32> = row.iter().step_by(3).copied().collect();
        for lag in 95..=107 {
            let found = template.correlate(&start, lag);
            let late = -f64::from(found.product.arg()) / template.mean_rad;
            // A third of a period at most; the emission's skew bends the phase a little.
            assert!((late - (101 - lag) as f64).abs() < 0.15, "lag {lag}: {late} left");
        }
        let best = template.correlate(&start, 101);
        assert!(best.coefficient > 0.999 && (best.amplitude - 0.5).abs() < 1e-3, "{best:?}");
        let flank = template.correlate(&start, 101 + template.flank).coefficient;
        assert!((0.4..0.9).contains(&flank), "{flank}");
        // A hyperbolic sweep recorded 1 % fast seems early by T f1 / (f0 - f1) / 100: 25 us.
        assert!((template.rate_shift - 11.25).abs() < 2.0, "{}", template.rate_shift);
        assert_eq!(template.correlate(&start, -1), Correlation::default());
        assert_eq!(template.correlate(&start, 1_900), Correlation::default());
    }
}
