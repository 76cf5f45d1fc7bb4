//! The emission as an echo of any delay and colour needs it: filtered by a few basis responses, finely interpolated.
//!
//! A path's frequency response is given at [`NODES`] frequencies of the emission's band and is a polynomial between them
//! (Lagrange), so the echo's waveform is a weighted sum of the emission filtered by the basis polynomials. Delays are made
//! by cubic interpolation between [`PHASES`] exact sub-sample shifts; the error is below 2e-5 of the amplitude.

use crate::sensor::Emission;
use rustfft::{FftPlanner, num_complex::Complex};
use std::f64::consts::{PI, TAU};

/// Frequencies at which a path's response is given.
pub(super) const NODES: usize = 4;
/// Sub-sample shifts kept of each waveform.
const PHASES: usize = 8;
/// Samples kept before and after the emission, for what filtering and band limitation spread.
const GUARD: usize = 32;

/// A path's frequency response at the nodes.
pub(super) type Response = [Complex<f64>; NODES];

/// The filtered and shifted emission.
#[derive(Debug, Clone)]
pub(super) struct WaveformTable {
    /// The frequencies that responses are given at.
    pub(super) nodes_hz: [f64; NODES],
    /// Share of the emission's energy that each node stands for; the shares sum to 1.
    pub(super) energy_share: [f64; NODES],
    /// `[node][in phase, quadrature][phase][sample]`.
    basis: Vec<f32>,
    row_len: usize,
}

/// One echo's waveform: `[phase][sample]`, as composed by [`WaveformTable::compose`].
#[derive(Debug, Clone, Default)]
pub(super) struct Waveform {
    rows: Vec<f32>,
    row_len: usize,
}

impl WaveformTable {
    pub(super) fn new(emission: &Emission) -> Self {
        let row_len = emission.samples.len() + 2 * GUARD;
        let transform_len = (row_len + 2 * GUARD).next_power_of_two();
        let nodes_hz = chebyshev_nodes(emission.band_hz);
        let mut planner = FftPlanner::<f64>::new();
        let forward = planner.plan_fft_forward(transform_len);
        let inverse = planner.plan_fft_inverse(transform_len);
        let mut spectrum = vec![Complex::new(0.0, 0.0); transform_len];
        for (bin, sample) in spectrum.iter_mut().zip(&emission.samples) {
            bin.re = *sample;
        }
        forward.process(&mut spectrum);
        let half = transform_len / 2;
        let bin_hz = emission.sample_rate_hz / transform_len as f64;
        let mut energy_share = [0.0; NODES];
        let mut basis = Vec::with_capacity(NODES * 2 * PHASES * row_len);
        let mut shifted = vec![Complex::new(0.0, 0.0); transform_len];
        for (node, share) in energy_share.iter_mut().enumerate() {
            let weight = |bin: usize| lagrange(&nodes_hz, node, bin as f64 * bin_hz, emission.band_hz);
            *share = (0..half).map(|bin| spectrum[bin].norm_sqr() * weight(bin)).sum();
            for quadrature in [Complex::new(1.0, 0.0), Complex::new(0.0, 1.0)] {
                for phase in 0..PHASES {
                    // Only positive frequencies, doubled: the real part of the result is the signal wanted.
                    shifted.fill(Complex::new(0.0, 0.0));
                    for bin in 1..half {
                        let angle = TAU * bin as f64 / transform_len as f64 * (phase as f64 / PHASES as f64);
                        shifted[bin] = spectrum[bin] * quadrature * Complex::from_polar(2.0 * weight(bin), angle);
                    }
                    inverse.process(&mut shifted);
                    basis.extend((0..row_len).map(|sample| {
                        (shifted[(sample + transform_len - GUARD) % transform_len].re / transform_len as f64) as f32
                    }));
                }
            }
        }
        let energy: f64 = energy_share.iter().sum();
        energy_share.iter_mut().for_each(|share| *share /= energy);
        Self { nodes_hz, energy_share, basis, row_len }
    }

    /// An empty waveform with room for [`WaveformTable::compose`].
    pub(super) fn waveform(&self) -> Waveform {
        Waveform { rows: vec![0.0; PHASES * self.row_len], row_len: self.row_len }
    }

    /// Filters the emission by `response` into `out`.
    pub(super) fn compose(&self, response: &Response, out: &mut Waveform) {
        let len = PHASES * self.row_len;
        out.row_len = self.row_len;
        out.rows.resize(len, 0.0);
        out.rows.fill(0.0);
        for (node, gain) in response.iter().enumerate() {
            for (part, weight) in [gain.re as f32, gain.im as f32].into_iter().enumerate() {
                if weight == 0.0 {
                    continue;
                }
                let start = (2 * node + part) * len;
                for (sum, value) in out.rows.iter_mut().zip(&self.basis[start..start + len]) {
                    *sum += weight * value;
                }
            }
        }
    }
}

impl Waveform {
    /// Adds the waveform to `samples`, delayed by `delay_samples` and times `amplitude`.
    pub(super) fn add_to(&self, samples: &mut [f32], delay_samples: f64, amplitude: f64) {
        let position = -delay_samples * PHASES as f64;
        let whole = position.floor();
        let fraction = position - whole;
        let weights = cubic(fraction).map(|weight| (weight * amplitude) as f32);
        let taps: [(usize, i64); 4] = std::array::from_fn(|tap| {
            let shift = whole as i64 + tap as i64 - 1;
            (shift.rem_euclid(PHASES as i64) as usize, shift.div_euclid(PHASES as i64) + GUARD as i64)
        });
        // taps[3] is the latest: the first output sample is the one for which no tap lies before its row.
        let first = (-taps[0].1).max(0);
        let last = (self.row_len as i64 - taps[3].1).min(samples.len() as i64);
        if first >= last {
            return;
        }
        let count = (last - first) as usize;
        let rows: [&[f32]; 4] = taps.map(|(phase, offset)| {
            let start = phase * self.row_len + (first + offset) as usize;
            &self.rows[start..start + count]
        });
        let out = &mut samples[first as usize..first as usize + count];
        for ((((sum, a), b), c), d) in out.iter_mut().zip(rows[0]).zip(rows[1]).zip(rows[2]).zip(rows[3]) {
            *sum += weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d;
        }
    }
}

/// Chebyshev nodes of the band, lowest first.
fn chebyshev_nodes((low_hz, high_hz): (f64, f64)) -> [f64; NODES] {
    std::array::from_fn(|node| {
        let x = -(PI * (node as f64 + 0.5) / NODES as f64).cos();
        0.5 * (low_hz + high_hz) + 0.5 * (high_hz - low_hz) * x
    })
}

/// Lagrange polynomial of `node` at `frequency_hz`, constant a little outside the band, where the emission is weak.
fn lagrange(nodes_hz: &[f64; NODES], node: usize, frequency_hz: f64, (low_hz, high_hz): (f64, f64)) -> f64 {
    let margin_hz = 0.1 * (high_hz - low_hz);
    let inside_hz = frequency_hz.clamp(low_hz - margin_hz, high_hz + margin_hz);
    (0..NODES)
        .filter(|&other| other != node)
        .map(|other| (inside_hz - nodes_hz[other]) / (nodes_hz[node] - nodes_hz[other]))
        .product()
}

/// Weights of the grid points -1, 0, 1, 2 for the value at `x` in [0, 1).
fn cubic(x: f64) -> [f64; 4] {
    [
        -x * (x - 1.0) * (x - 2.0) / 6.0,
        (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
        -(x + 1.0) * x * (x - 2.0) / 2.0,
        (x + 1.0) * x * (x - 1.0) / 6.0,
    ]
}
