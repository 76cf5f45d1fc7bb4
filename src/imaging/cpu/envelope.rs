//! Band spectra of the beams to the energyscape (plan, step 5; specification, section 3).
//!
//! In: complex `[direction][bin]` in blocks. Out: `[direction][range]`. The bins are folded into M, transformed back, and the
//! magnitude of the analytic signal is the envelope. Twin of `shaders/envelope.wgsl`.

use super::delay_and_sum::BLOCK;
use super::simd::{Vector, multiply_add};
use rustfft::num_complex::Complex;

/// Adds one block of a beam's bins to its places in the transform: `first_bin` is the block's first absolute index.
pub(super) fn fold(first_bin: usize, bins: &[Complex<f32>], transform: &mut [Complex<f32>]) {
    let length = transform.len();
    let mut place = first_bin % length;
    let mut rest = bins;
    while !rest.is_empty() {
        let (now, later) = rest.split_at(rest.len().min(length - place));
        for (sum, bin) in transform[place..].iter_mut().zip(now) {
            *sum += bin;
        }
        (place, rest) = (0, later);
    }
}

/// Number of blocks that `bin_count` bins make.
pub(super) fn block_count(bin_count: usize) -> usize {
    bin_count.div_ceil(BLOCK)
}

/// The envelope of one direction.
pub(super) struct EnvelopeTask<'a> {
    /// The analytic signal, M values.
    pub signal: &'a [Complex<f32>],
    /// Smoothing FIR; empty for none.
    pub taps: &'a [f32],
    /// Scratch of M values for the smoothing.
    pub magnitudes: &'a mut [f32],
    /// `[range]`.
    pub output: &'a mut [f32],
}

/// Magnitude, smoothed if wanted. Outputs beyond either end are those of the transform's own circle: earlier and later times.
#[inline(always)]
pub(super) fn magnitude<V: Vector>(task: EnvelopeTask<'_>) {
    let EnvelopeTask { signal, taps, magnitudes, output } = task;
    if taps.is_empty() {
        magnitudes_of::<V>(signal, output);
        return;
    }
    magnitudes_of::<V>(signal, magnitudes);
    let length = magnitudes.len();
    for (index, output) in output.iter_mut().enumerate() {
        let start = index + length - taps.len() / 2;
        *output = taps
            .iter()
            .enumerate()
            .fold(0.0, |sum, (offset, tap)| multiply_add::<V>(*tap, magnitudes[(start + offset) % length], sum));
    }
}

#[inline(always)]
fn magnitudes_of<V: Vector>(signal: &[Complex<f32>], output: &mut [f32]) {
    for (output, value) in output.iter_mut().zip(signal) {
        *output = multiply_add::<V>(value.re, value.re, value.im * value.im).sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folding_wraps_as_often_as_needed() {
        let bins: Vec<Complex<f32>> = (0..7).map(|k| Complex::new(k as f32, 1.0)).collect();
        let mut transform = [Complex::default(); 3];
        fold(8, &bins, &mut transform);
        // Bins 8 to 14 go to 2, 0, 1, 2, 0, 1, 2.
        assert_eq!(transform, [Complex::new(5.0, 2.0), Complex::new(7.0, 2.0), Complex::new(9.0, 3.0)]);
    }
}
