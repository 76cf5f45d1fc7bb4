//! Band spectra of the channels to the channel signals that focusing reads (plan, `focus`).
//!
//! In: `[bin][re, im][channel]` of one vector of channels. Out: `[channel][row][re, im][sample]`, complex basebands of the matched filter's
//! output, of which row p holds samples p, p + oversampling ..., so that the samples of neighbouring ranges are neighbours. Twin of
//! `signal_first` to `signal_last` in `shaders/focus.wgsl`.

use super::aligned::{rows, rows_mut};
use super::simd::Vector;
use super::transform::{self, Transform};
use crate::imaging::plan::FocusPlan;

/// One vector of channels.
pub(super) struct SignalTask<'a> {
    pub focus: &'a FocusPlan,
    pub transform: &'a Transform,
    /// Absolute index of the first bin.
    pub first_bin: usize,
    /// `[bin][re, im][lane]`.
    pub spectrum: &'a [f32],
    /// The transform's buffer.
    pub values: &'a mut [f32],
    /// Scratch of lanes times lanes values.
    pub square: &'a mut [f32],
    /// `[sub-band][lane][row][re, im][sample]`.
    pub signals: &'a mut [f32],
}

/// Values of the signals of `channels` channels.
pub(super) fn signals_len(focus: &FocusPlan, channels: usize) -> usize {
    2 * focus.row_len * focus.oversampling * channels * focus.combine.sub_bands
}

/// Transforms back, and takes out the stretch that focusing reads.
#[inline(always)]
pub(super) fn channel_signal<V: Vector>(task: SignalTask<'_>) {
    let SignalTask { focus, transform, first_bin, spectrum, values, square, signals } = task;
    let of_band = signals.len() / focus.combine.sub_bands;
    for (sub_band, signals) in signals.chunks_exact_mut(of_band).enumerate() {
        band_signal::<V>(focus, transform, (first_bin, sub_band), spectrum, values);
        keep_rows::<V>(focus, values, square, signals);
    }
}

/// Transforms the bins of one sub-band back.
#[inline(always)]
fn band_signal<V: Vector>(
    focus: &FocusPlan,
    transform: &Transform,
    (first_bin, sub_band): (usize, usize),
    spectrum: &[f32],
    values: &mut [f32],
) {
    let len = focus.signal_len;
    values.fill(0.0);
    let buffer = rows_mut::<V>(values);
    // Negative frequencies stand at the end of the circle.
    let mut index = (first_bin + len - focus.centre_bin % len) % len;
    let pairs = rows::<V>(spectrum).as_chunks::<2>().0;
    for (bin, pair) in pairs.iter().enumerate() {
        // Parts exchanged: the inverse transform.
        let row = 2 * transform.place(index);
        (buffer[row], buffer[row + 1]) = (pair[1], pair[0]);
        if focus.combine.sub_bands > 1 {
            let share = V::splat(focus.combine.share(sub_band, bin, pairs.len()));
            V::load(&pair[1]).mul(share).store(&mut buffer[row]);
            V::load(&pair[0]).mul(share).store(&mut buffer[row + 1]);
        }
        index = if index + 1 == len { 0 } else { index + 1 };
    }
    transform::forward::<V>(transform, values);
}

/// Takes out the stretch that focusing reads.
#[inline(always)]
fn keep_rows<V: Vector>(focus: &FocusPlan, values: &[f32], square: &mut [f32], signals: &mut [f32]) {
    let len = focus.signal_len;
    let values = rows::<V>(values);
    let square = &mut rows_mut::<V>(square)[..V::LANES];
    let (oversampling, row_len) = (focus.oversampling, focus.row_len);
    for row in 0..oversampling {
        for part in 0..2 {
            for start in (0..row_len).step_by(V::LANES) {
                let count = V::LANES.min(row_len - start);
                for (sample, lanes) in (start..start + count).zip(square.iter_mut()) {
                    // The signal lies on a circle.
                    let n = (oversampling * sample + row + len * oversampling - oversampling * focus.lead) % len;
                    *lanes = values[2 * n + 1 - part];
                }
                V::transpose(square);
                for (lane, samples) in square.iter().enumerate() {
                    let first = ((lane * oversampling + row) * 2 + part) * row_len + start;
                    signals[first..first + count].copy_from_slice(&samples.as_ref()[..count]);
                }
            }
        }
    }
}
