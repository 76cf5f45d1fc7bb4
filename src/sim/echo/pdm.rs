//! One-bit words of the microphones: PCM in, PDM words out (bit k of a word = microphone k).
//!
//! Each microphone's samples are interpolated to the word rate by a windowed sinc and coded by a second-order
//! sigma-delta modulator in error-feedback form, whose signal transfer is 1: word i stands for the time i / word rate.
//! Quantisation noise is shaped by (1 - 1/z)^2.

use super::noise::Noise;
use std::f64::consts::PI;

/// Channels of a word.
pub(super) const CHANNELS: usize = 32;
/// Samples that an interpolated value is made of.
const TAPS: usize = 12;
/// A second-order one-bit modulator overloads near full scale.
const INPUT_MAX: f32 = 0.9;
/// Bound of the quantisation error: a sweep of 0.85 needs 6.5 (a lower bound adds noise), overload must end some day.
const ERROR_MAX: f32 = 8.0;

/// The modulators of one sensor's microphones.
#[derive(Debug, Clone)]
pub(super) struct PdmCoder {
    /// `[phase][tap]`.
    taps: Vec<[f32; TAPS]>,
}

impl PdmCoder {
    /// A coder that makes `decimation` words of each sample.
    pub(super) fn new(decimation: usize) -> Self {
        let taps = (0..decimation)
            .map(|phase| {
                let at = phase as f64 / decimation as f64;
                let raw: [f64; TAPS] = std::array::from_fn(|tap| {
                    let offset = tap as f64 - (TAPS / 2 - 1) as f64 - at;
                    sinc(offset) * window(offset / (TAPS as f64 / 2.0))
                });
                let sum: f64 = raw.iter().sum();
                raw.map(|tap| (tap / sum) as f32)
            })
            .collect();
        Self { taps }
    }

    /// Codes `pcm`, `[channel_count][samples]`, into `words`; `starts` draws the modulators' starting states.
    pub(super) fn encode(&self, pcm: &[f32], channel_count: usize, words: &mut [u32], starts: &mut Noise) {
        let decimation = self.taps.len();
        let samples = pcm.len() / channel_count;
        // Without different starts all silent microphones would whine in step.
        let mut error: [f32; CHANNELS] = std::array::from_fn(|_| starts.uniform());
        let mut error_before: [f32; CHANNELS] = std::array::from_fn(|_| starts.uniform());
        let mut window = [[0f32; CHANNELS]; TAPS];
        let ahead = TAPS / 2;
        for sample in 0..ahead.min(samples) {
            shift_in(&mut window, pcm, channel_count, samples, sample);
        }
        let used = if channel_count >= CHANNELS { u32::MAX } else { (1 << channel_count) - 1 };
        for (index, group) in words.chunks_mut(decimation).enumerate() {
            shift_in(&mut window, pcm, channel_count, samples, index + ahead);
            for (word, taps) in group.iter_mut().zip(&self.taps) {
                let mut input = [0f32; CHANNELS];
                for (row, tap) in window.iter().zip(taps) {
                    for (sum, value) in input.iter_mut().zip(row) {
                        *sum += tap * value;
                    }
                }
                *word = modulate(&input, &mut error, &mut error_before) & used;
            }
        }
    }
}

/// One step of all modulators: v = x + 2 e1 - e2, the bit is v's sign, the new error is v minus the bit's value.
fn modulate(input: &[f32; CHANNELS], error: &mut [f32; CHANNELS], error_before: &mut [f32; CHANNELS]) -> u32 {
    let mut bits = 0u32;
    for channel in 0..CHANNELS {
        let wanted = input[channel].clamp(-INPUT_MAX, INPUT_MAX) + 2.0 * error[channel] - error_before[channel];
        let value = 1f32.copysign(wanted);
        error_before[channel] = error[channel];
        error[channel] = (wanted - value).clamp(-ERROR_MAX, ERROR_MAX);
        bits |= u32::from(value > 0.0) << channel;
    }
    bits
}

fn shift_in(window: &mut [[f32; CHANNELS]; TAPS], pcm: &[f32], channel_count: usize, samples: usize, sample: usize) {
    window.copy_within(1.., 0);
    for (channel, value) in window[TAPS - 1].iter_mut().enumerate() {
        let heard = channel < channel_count && sample < samples;
        *value = if heard { pcm[channel * samples + sample] } else { 0.0 };
    }
}

fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-12 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

/// Kaiser's window (beta 8) on [-1, 1].
fn window(x: f64) -> f64 {
    let inside = 1.0 - x * x;
    if inside <= 0.0 { 0.0 } else { bessel_i0(8.0 * inside.sqrt()) / bessel_i0(8.0) }
}

fn bessel_i0(x: f64) -> f64 {
    let mut term = 1.0;
    let mut sum = 1.0;
    for order in 1..40 {
        term *= (0.5 * x / f64::from(order)).powi(2);
        sum += term;
    }
    sum
}
