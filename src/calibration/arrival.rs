//! When and how strongly the emission arrives in one channel, to a small part of a sample.
//!
//! In: the start of a channel at the full demodulated rate, and a lag to begin at. Out: the lag of the envelope's peak, the phase
//! there, amplitude, likeness and how much of the emission was cut off at full scale. A matched filter at a handful of lags in double
//! precision: the envelope's vertex says which period, the phase at that lag where in it. Cut tops leave the zero crossings where they
//! were, so the time stays good and only the amplitude is lost. Knows no array and judges nothing; allocates nothing.

use crate::imaging::direct_path::template::{analytic, flank, peak_in_flanks};
use crate::sensor::Emission;
use nalgebra::Complex;
use std::f64::consts::TAU;

/// Partial sums of an inner product, so that the compiler may use vector instructions.
const LANES: usize = 8;
/// Steps towards the envelope's peak; each comes at least to within a fifth of what was left.
const STEPS: usize = 5;
/// A sample whose size is at least this is cut off: the last value but a few of 16 bits.
const FULL_SCALE: f32 = 0.999;

/// What a channel is compared with: the emission as an analytic signal.
#[derive(Debug, Clone)]
pub struct Sweep {
    real: Vec<f64>,
    imaginary: Vec<f64>,
    energy: f64,
    /// Energy-weighted mean frequency, radians a sample.
    mean_rad: f64,
    flank: i64,
}

/// The emission in one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Lag of the envelope's peak, in samples after sample 0.
    pub envelope_lag: f64,
    /// Whole lag at which the phase was taken, next to that peak.
    pub lag: i64,
    /// Phase of the correlation at that lag, radians; it falls by [`Sweep::mean_rad`] for each sample that the emission is later.
    pub phase_rad: f64,
    /// Amplitude of the emission, in units of full scale.
    pub amplitude: f64,
    /// Correlation coefficient, 0 to 1.
    pub coefficient: f64,
    /// Share of the emission's samples that are cut off at full scale.
    pub clipped: f64,
}

impl Arrival {
    /// Lag, in samples, of a sweep whose transducers turn its phase by `shared_rad`.
    #[must_use]
    pub fn phase_lag(&self, sweep: &Sweep, shared_rad: f64) -> f64 {
        let turned = self.phase_rad - shared_rad;
        self.lag as f64 - (turned - TAU * (turned / TAU).round()) / sweep.mean_rad
    }

    /// The phase at the envelope's own peak, as a unit phasor: what the transducers turn the sweep by.
    #[must_use]
    pub fn phasor(&self, sweep: &Sweep) -> Complex<f64> {
        Complex::from_polar(1.0, self.phase_rad + (self.envelope_lag - self.lag as f64) * sweep.mean_rad)
    }
}

impl Sweep {
    /// Prepares for an emission.
    #[must_use]
    pub fn new(emission: &Emission) -> Self {
        let (analytic, mean_rad, spread_rad) = analytic(&emission.samples);
        Self {
            real: analytic.iter().map(|value| value.re).collect(),
            imaginary: analytic.iter().map(|value| value.im).collect(),
            energy: analytic.iter().map(|value| value.re * value.re).sum(),
            mean_rad,
            flank: flank(spread_rad),
        }
    }

    /// Energy-weighted mean frequency, radians a sample.
    #[must_use]
    pub fn mean_rad(&self) -> f64 {
        self.mean_rad
    }

    /// Samples of a start that holds the emission at `last_lag` and what is looked at beside it.
    #[must_use]
    pub fn start_len(&self, last_lag: usize) -> usize {
        last_lag + self.real.len() + 3 * self.flank as usize
    }

    /// Finds the emission near `lag` in the `start` of a channel. `None` where no peak of the envelope is within three flanks of it,
    /// where it does not lie within the samples, and for silence, NaN and infinities.
    #[must_use]
    pub fn find(&self, start: &[f32], lag: f64) -> Option<Arrival> {
        let (mut lag_now, reach) = (lag.round() as i64, 3 * self.flank);
        let mut envelope_lag = lag;
        for _ in 0..STEPS {
            let size = |lag: i64| self.correlate(start, lag).map(|product| product.norm());
            let sizes = [size(lag_now - self.flank)?, size(lag_now)?, size(lag_now + self.flank)?];
            envelope_lag = lag_now as f64 + peak_in_flanks(sizes) * self.flank as f64;
            let next = envelope_lag.round() as i64;
            if (next as f64 - lag).abs() > reach as f64 || !envelope_lag.is_finite() {
                return None;
            }
            if next == lag_now {
                break;
            }
            lag_now = next;
        }
        let product = self.correlate(start, lag_now)?;
        let first = usize::try_from(lag_now).ok()?;
        let heard = start.get(first..first + self.real.len())?;
        let power: f64 = heard.iter().map(|sample| f64::from(*sample).powi(2)).sum();
        let size = product.norm();
        let coefficient = size / (power * self.energy).sqrt();
        let clipped = heard.iter().filter(|sample| sample.abs() >= FULL_SCALE).count();
        (coefficient.is_finite() && size > 0.0).then_some(Arrival {
            envelope_lag,
            lag: lag_now,
            phase_rad: product.arg(),
            amplitude: size / self.energy,
            coefficient,
            clipped: clipped as f64 / heard.len() as f64,
        })
    }

    /// Sum of the samples times the conjugate of the analytic emission at `lag`.
    fn correlate(&self, start: &[f32], lag: i64) -> Option<Complex<f64>> {
        let first = usize::try_from(lag).ok()?;
        let heard = start.get(first..first + self.real.len())?;
        let mut sums = [[0.0_f64; LANES]; 2];
        let done = heard.len() - heard.len() % LANES;
        let parts =
            heard.chunks_exact(LANES).zip(self.real.chunks_exact(LANES)).zip(self.imaginary.chunks_exact(LANES));
        for ((heard, real), imaginary) in parts {
            for lane in 0..LANES {
                let sample = f64::from(heard[lane]);
                sums[0][lane] += sample * real[lane];
                sums[1][lane] += sample * imaginary[lane];
            }
        }
        let mut product = Complex::new(sums[0].iter().sum::<f64>(), -sums[1].iter().sum::<f64>());
        for ((sample, real), imaginary) in heard[done..].iter().zip(&self.real[done..]).zip(&self.imaginary[done..]) {
            product += Complex::new(*real, -*imaginary) * f64::from(*sample);
        }
        Some(product)
    }
}
