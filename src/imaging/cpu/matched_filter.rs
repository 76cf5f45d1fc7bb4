//! PCM of a block of channels to their matched-filtered band spectra (plan, steps 1 to 3; specification, section 3).
//!
//! In: `[sample][lane]`, lanes being channels, full scale 1. Out: `[bin][re, im][lane]`, times the channels' gains. A complex band-pass
//! keeps the band and decimates, a short transform follows, the reference divides the band-pass out again. Twin of
//! `shaders/matched_filter.wgsl`.

use super::aligned::{rows, rows_mut};
use super::simd::Vector;
use super::transform::{self, Transform};
use crate::imaging::plan::{ImagingPlan, PHAT_POWER_MIN};

/// A stretch of outputs of the band-pass.
pub(super) struct BandPassTask<'a> {
    /// The plan's taps.
    pub taps: &'a [[f32; 2]],
    /// Samples between two outputs.
    pub step: usize,
    /// `[sample][lane]`: all that the outputs reach.
    pub tile: &'a [f32],
    /// `[output][re, im][lane]`.
    pub output: &'a mut [f32],
}

/// Filters and decimates. Every output is summed in the same order, however they are grouped.
#[inline(always)]
pub(super) fn band_pass<V: Vector>(task: BandPassTask<'_>) {
    let BandPassTask { taps, step, tile, output } = task;
    let (tile, output) = (rows::<V>(tile), rows_mut::<V>(output));
    let count = output.len() / 2;
    // As many outputs at once as leave their sums in registers.
    let mut index = 0;
    if V::LANES >= 16 {
        while index + 8 <= count {
            outputs::<V, 8>(taps, step, &tile[index * step..], &mut output[2 * index..][..16]);
            index += 8;
        }
    }
    while index + 4 <= count {
        outputs::<V, 4>(taps, step, &tile[index * step..], &mut output[2 * index..][..8]);
        index += 4;
    }
    while index < count {
        outputs::<V, 1>(taps, step, &tile[index * step..], &mut output[2 * index..][..2]);
        index += 1;
    }
}

/// `OUTPUTS` outputs, `step` samples apart.
#[inline(always)]
fn outputs<V: Vector, const OUTPUTS: usize>(taps: &[[f32; 2]], step: usize, tile: &[V::Row], output: &mut [V::Row]) {
    // Loops rather than closures: a closure that is not inlined is not compiled for the instruction set.
    let mut samples = [&tile[..0]; OUTPUTS];
    for (place, samples) in samples.iter_mut().enumerate() {
        *samples = &tile[place * step..][..taps.len()];
    }
    let mut sums = [[V::splat(0.0); 2]; OUTPUTS];
    for (index, tap) in taps.iter().enumerate() {
        let (re, im) = (V::splat(tap[0]), V::splat(tap[1]));
        for place in 0..OUTPUTS {
            let value = V::load(&samples[place][index]);
            sums[place][0] = value.mul_add(re, sums[place][0]);
            sums[place][1] = value.mul_add(im, sums[place][1]);
        }
    }
    for (sum, rows) in sums.iter().zip(output.as_chunks_mut::<2>().0) {
        sum[0].store(&mut rows[0]);
        sum[1].store(&mut rows[1]);
    }
}

/// Outputs of the band-pass on their way into the transform, or, when they are all there, the transform.
pub(super) enum SpectrumTask<'a> {
    /// Puts a stretch of outputs where the transform wants them.
    Place {
        transform: &'a Transform,
        /// Index of the first output.
        first: usize,
        /// `[output][re, im][lane]`.
        outputs: &'a [f32],
        /// The transform's buffer.
        values: &'a mut [f32],
    },
    /// Transforms, takes the band out and multiplies it with reference and gains.
    Apply {
        transform: &'a Transform,
        plan: &'a ImagingPlan,
        /// The sensor's own, `[bin]`.
        reference: &'a [[f32; 2]],
        /// Gain of each lane; a gain of zero gives zeros whatever the channel holds.
        gains: &'a [f32],
        values: &'a mut [f32],
        /// `[bin][re, im][lane]`.
        spectrum: &'a mut [f32],
    },
}

/// Does one [`SpectrumTask`].
#[inline(always)]
pub(super) fn spectrum<V: Vector>(task: SpectrumTask<'_>) {
    match task {
        SpectrumTask::Place { transform, first, outputs, values } => {
            let values = rows_mut::<V>(values);
            for (index, output) in rows::<V>(outputs).as_chunks::<2>().0.iter().enumerate() {
                let row = 2 * transform.place(first + index);
                (values[row], values[row + 1]) = (output[0], output[1]);
            }
        }
        SpectrumTask::Apply { transform, plan, reference, gains, values, spectrum } => {
            transform::forward::<V>(transform, values);
            let (values, spectrum) = (rows::<V>(values), rows_mut::<V>(spectrum));
            let gains = V::load(&rows::<V>(gains)[0]);
            let zero = V::splat(0.0);
            let mut index = plan.first_bin % plan.forward_len;
            for (output, reference) in spectrum.as_chunks_mut::<2>().0.iter_mut().zip(reference) {
                let (mut re, mut im) = (V::load(&values[2 * index]), V::load(&values[2 * index + 1]));
                if plan.phat {
                    (re, im) = unit_magnitude(re, im);
                }
                let [cos, sin] = reference.map(V::splat);
                let product = [im.neg_mul_add(sin, re.mul(cos)), im.mul_add(cos, re.mul(sin))];
                for (output, part) in output.iter_mut().zip(product) {
                    zero.where_less(gains, part.mul(gains), zero).store(output);
                }
                index = if index + 1 == plan.forward_len { 0 } else { index + 1 };
            }
        }
    }
}

/// PHAT: the phase alone; silence has none.
#[inline(always)]
fn unit_magnitude<V: Vector>(re: V, im: V) -> (V, V) {
    let power = re.mul_add(re, im.mul(im));
    let (least, zero, magnitude) = (V::splat(PHAT_POWER_MIN), V::splat(0.0), power.sqrt());
    (least.where_less(power, re.div(magnitude), zero), least.where_less(power, im.div(magnitude), zero))
}
