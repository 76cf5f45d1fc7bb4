//! PCM of a channel to its matched-filtered band spectrum (plan, steps 1 to 3; specification, section 3).
//!
//! In: `[sample]`, full scale 1. Out: complex `[bin]`, times the channel's gain. A complex band-pass keeps the band and
//! decimates, a short transform follows, the reference divides the band-pass out again. Twin of `shaders/matched_filter.wgsl`.

use super::simd::Vector;
use crate::imaging::plan::{ImagingPlan, PHAT_POWER_MIN};
use rustfft::num_complex::Complex;

/// The band-pass, laid out for vectors.
#[derive(Debug)]
pub(super) struct BandPass {
    /// Real and imaginary parts, padded with zeros to whole vectors.
    taps: [Vec<f32>; 2],
    /// Taps before the middle one.
    half: usize,
    decimation: usize,
    /// N, after which indices wrap around.
    span: usize,
    sample_count: usize,
}

impl BandPass {
    /// Copies the taps of `plan`, padded to whole vectors of 16.
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let padded = plan.band_taps.len().next_multiple_of(16);
        let part = |index: usize| {
            plan.band_taps.iter().map(|tap| tap[index]).chain(std::iter::repeat(0.0)).take(padded).collect()
        };
        Self {
            taps: [part(0), part(1)],
            half: plan.band_taps.len() / 2,
            decimation: plan.band_decimation,
            span: plan.forward_len * plan.band_decimation,
            sample_count: plan.sample_count,
        }
    }

    /// Taps with padding: samples that one output reads.
    pub(super) fn window_len(&self) -> usize {
        self.taps[0].len()
    }

    /// Outputs `first..end` whose window lies inside the samples.
    fn inside(&self, output_count: usize) -> std::ops::Range<usize> {
        let first = self.half.div_ceil(self.decimation);
        let last_start = (self.sample_count + self.half).checked_sub(self.window_len());
        let end = last_start.map_or(0, |start| start / self.decimation + 1).min(output_count);
        first.min(end)..end
    }
}

/// One channel through the band-pass.
pub(super) struct BandPassTask<'a> {
    pub filter: &'a BandPass,
    /// `[sample]`.
    pub samples: &'a [f32],
    /// Scratch of [`BandPass::window_len`] values.
    pub window: &'a mut [f32],
    /// `[output]`, N1 of them.
    pub output: &'a mut [Complex<f32>],
}

/// Filters and decimates.
#[inline(always)]
pub(super) fn band_pass<V: Vector>(task: BandPassTask<'_>) {
    let BandPassTask { filter, samples, window, output } = task;
    let inside = filter.inside(output.len());
    let (length, step) = (filter.window_len(), filter.decimation);
    let mut index = inside.start;
    while index + 4 <= inside.end {
        let start = index * step - filter.half;
        // Loops rather than closures: a closure that is not inlined is not compiled for the instruction set.
        let mut rows = [&samples[..0]; 4];
        for (row, values) in rows.iter_mut().enumerate() {
            *values = &samples[start + row * step..][..length];
        }
        let sums = dot_rows::<V, 4>(&filter.taps, rows);
        output[index..index + 4].copy_from_slice(&sums);
        index += 4;
    }
    for index in (0..inside.start).chain(index..output.len()) {
        for (offset, value) in window.iter_mut().enumerate() {
            let place = (index * step + offset + filter.span - filter.half) % filter.span;
            *value = samples.get(place).copied().unwrap_or(0.0);
        }
        let [sum] = dot_rows::<V, 1>(&filter.taps, [&*window]);
        output[index] = sum;
    }
}

/// Products of the complex taps with `ROWS` windows. Every output is summed in the same order, however it is grouped.
#[inline(always)]
fn dot_rows<V: Vector, const ROWS: usize>(taps: &[Vec<f32>; 2], rows: [&[f32]; ROWS]) -> [Complex<f32>; ROWS] {
    let mut sums = [[V::splat(0.0); 2]; ROWS];
    let (re, im) = (taps[0].chunks_exact(V::LANES), taps[1].chunks_exact(V::LANES));
    for (chunk, (re, im)) in re.zip(im).enumerate() {
        let (re, im) = (V::load(re), V::load(im));
        for row in 0..ROWS {
            let values = V::load(&rows[row][chunk * V::LANES..]);
            sums[row][0] = re.mul_add(values, sums[row][0]);
            sums[row][1] = im.mul_add(values, sums[row][1]);
        }
    }
    let mut outputs = [Complex::default(); ROWS];
    for row in 0..ROWS {
        outputs[row] = Complex::new(sums[row][0].sum(), sums[row][1].sum());
    }
    outputs
}

/// Takes the band out of the transform and multiplies it with reference and gain; a gain of zero gives zeros whatever the
/// transform holds.
pub(super) fn apply_reference(
    plan: &ImagingPlan,
    gain: f32,
    transform: &[Complex<f32>],
    spectrum: &mut [Complex<f32>],
) {
    if gain == 0.0 {
        spectrum.fill(Complex::default());
        return;
    }
    let first = plan.first_bin % plan.forward_len;
    let wrapped = transform[first..].iter().chain(&transform[..first]);
    for ((output, value), reference) in spectrum.iter_mut().zip(wrapped).zip(&plan.reference) {
        let value = if plan.phat { unit_magnitude(*value) } else { *value };
        *output = value * Complex::new(reference[0], reference[1]) * gain;
    }
}

/// PHAT: the phase alone; silence has none.
fn unit_magnitude(value: Complex<f32>) -> Complex<f32> {
    let power = value.norm_sqr();
    if power > PHAT_POWER_MIN { value / power.sqrt() } else { Complex::default() }
}
