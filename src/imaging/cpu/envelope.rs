//! Band spectra of the beams to rows of the energyscape (plan, step 5; specification, section 3).
//!
//! In: the transform's buffer with the beams' bins, one direction a lane. Out: `[direction][range]`. The magnitude of the analytic
//! signal is the envelope. Twin of `shaders/envelope.wgsl`.

use super::aligned::rows_mut;
use super::shared_image::RowGuard;
use super::simd::Vector;
use super::transform::{self, Transform};

/// The envelopes of as many directions as a vector has lanes.
pub(super) struct EnvelopeTask<'a, 'b> {
    pub transform: &'a Transform,
    /// Smoothing FIR; empty for none.
    pub taps: &'a [f32],
    /// The transform's buffer: bins with real and imaginary parts exchanged, which makes the transform an inverse one. Destroyed.
    pub values: &'a mut [f32],
    /// Scratch of lanes times lanes values.
    pub square: &'a mut [f32],
    /// The lanes' rows of the image; none for a lane without a direction.
    pub rows: &'a mut [Option<RowGuard<'b>>],
    /// Ranges of a row.
    pub range_count: usize,
}

/// Transforms and takes the magnitude, smoothed if wanted. Outputs beyond either end are those of the transform's own circle: earlier
/// and later times.
#[inline(always)]
pub(super) fn envelope<V: Vector>(task: EnvelopeTask<'_, '_>) {
    let EnvelopeTask { transform, taps, values, square, rows, range_count } = task;
    transform::forward::<V>(transform, values);
    let values = rows_mut::<V>(values);
    let length = values.len() / 2;
    // Magnitudes replace the values from the front: no row is read after it was written.
    for index in 0..if taps.is_empty() { range_count } else { length } {
        let (re, im) = (V::load(&values[2 * index]), V::load(&values[2 * index + 1]));
        re.mul_add(re, im.mul(im)).sqrt().store(&mut values[index]);
    }
    let magnitudes = &values[..length];
    let square = &mut rows_mut::<V>(square)[..V::LANES];
    for start in (0..range_count).step_by(V::LANES) {
        let count = V::LANES.min(range_count - start);
        for (index, row) in (start..start + count).zip(square.iter_mut()) {
            *row = if taps.is_empty() { magnitudes[index] } else { smoothed::<V>(magnitudes, taps, index) };
        }
        V::transpose(square);
        for (row, lane) in rows.iter_mut().zip(square.iter()) {
            let Some(row) = row else { continue };
            let output = &mut row[start..start + count];
            if count == V::LANES {
                rows_mut::<V>(output)[0] = *lane;
            } else {
                output.copy_from_slice(&lane.as_ref()[..count]);
            }
        }
    }
}

#[inline(always)]
fn smoothed<V: Vector>(magnitudes: &[V::Row], taps: &[f32], index: usize) -> V::Row {
    let length = magnitudes.len();
    let start = index + length - taps.len() / 2;
    let mut sum = V::splat(0.0);
    for (offset, tap) in taps.iter().enumerate() {
        sum = V::load(&magnitudes[(start + offset) % length]).mul_add(V::splat(*tap), sum);
    }
    let mut row = magnitudes[index];
    sum.store(&mut row);
    row
}
