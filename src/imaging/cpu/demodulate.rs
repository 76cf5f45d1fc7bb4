//! PDM words to PCM: a low-pass FIR on bits that count as +1 and -1, decimated, its delay compensated (specification, section 2).
//!
//! In: words of one sensor, bit k = channel k. Out: `[block][sample][lane]`, lanes being channels, full scale 1. The bits are sorted
//! by channel first; then three or four taps at once are one look-up of the bits' sum in a register. Twin of
//! `shaders/demodulate.wgsl`. Never judges channels.

use super::aligned::rows_mut;
use super::simd::{PLANE_WORDS, PLANES, Vector};

/// Channels of a PDM word.
pub(super) const WORD_CHANNELS: usize = PLANES;
/// Bits between two windows of a channel's bits; a window has twice as many.
const WINDOW_STEP: usize = 16;
/// Outputs computed side by side: enough independent sums to hide the latency of an addition.
const SIDE_BY_SIDE: usize = 8;

/// The FIR, laid out for look-ups.
#[derive(Debug)]
pub(super) struct BitFilter {
    /// `[group of taps][bits of the group]`: twice the sum of the taps at one-bits.
    tables: Vec<[f32; 16]>,
    taps: Vec<f64>,
    decimation: usize,
    /// Outputs after which bits are at the same place in their window again.
    period: usize,
}

impl BitFilter {
    /// Tables for look-ups of `lookup_bits` bits.
    pub(super) fn new(taps: &[f32], decimation: usize, lookup_bits: usize) -> Self {
        let taps: Vec<f64> = taps.iter().map(|tap| f64::from(*tap)).collect();
        let table = |group: &[f64]| {
            std::array::from_fn(|bits| {
                let one = |(bit, tap): (usize, &f64)| if bits >> bit & 1 == 1 { 2.0 * tap } else { 0.0 };
                group.iter().enumerate().map(one).sum::<f64>() as f32
            })
        };
        let common = (0..=WINDOW_STEP.ilog2()).rev().map(|bit| 1 << bit).find(|step| decimation.is_multiple_of(*step));
        Self {
            tables: taps.chunks(lookup_bits).map(table).collect(),
            period: WINDOW_STEP / common.unwrap_or(1),
            taps,
            decimation,
        }
    }

    /// `sample_count` rounded up to what is computed side by side.
    pub(super) fn padded(&self, sample_count: usize) -> usize {
        sample_count.next_multiple_of(self.period * SIDE_BY_SIDE)
    }

    /// Windows that the outputs of a piece need.
    pub(super) fn window_count(&self, sample_count: usize) -> usize {
        let bits = self.padded(sample_count) * self.decimation + self.taps.len() + 2 * WINDOW_STEP;
        bits.next_multiple_of(PLANE_WORDS) / WINDOW_STEP
    }

    /// Sum of the taps that fall into a ping of `word_count` words around `centre`: outside there is neither +1 nor -1.
    fn inside(&self, centre: usize, word_count: usize) -> f32 {
        let half = self.taps.len() / 2;
        let first = half.saturating_sub(centre);
        let end = self.taps.len().min((word_count + half).saturating_sub(centre));
        self.taps[first.min(end)..end].iter().sum::<f64>() as f32
    }
}

/// A piece of a ping: outputs `first_sample .. first_sample + sample_count` of all channels.
pub(super) struct DemodulateTask<'a> {
    pub filter: &'a BitFilter,
    /// The whole ping.
    pub words: &'a [u32],
    /// First output.
    pub first_sample: usize,
    /// Number of outputs.
    pub sample_count: usize,
    /// Scratch of [`BitFilter::window_count`].
    pub windows: &'a mut [[u32; WORD_CHANNELS]],
    /// `[block][sample, padded][lane]`.
    pub output: &'a mut [f32],
}

/// Demodulates one piece.
#[inline(always)]
pub(super) fn demodulate<V: Vector>(task: DemodulateTask<'_>) {
    let DemodulateTask { filter, words, first_sample, sample_count, windows, output } = task;
    let half = filter.taps.len() / 2;
    let padded = filter.padded(sample_count);
    let windows = &mut windows[..filter.window_count(sample_count)];
    // The first bit of the first window is under the first tap of the first output.
    sort_bits::<V>(words, (first_sample * filter.decimation) as i64 - half as i64, windows);
    let whole = filter.inside(half, 2 * half + 1);
    for (block, output) in rows_mut::<V>(output).chunks_exact_mut(padded).enumerate() {
        for start in (0..padded).step_by(filter.period * SIDE_BY_SIDE) {
            for phase in 0..filter.period {
                let sums = ones_of::<V>(filter, windows, block * V::LANES, start + phase);
                for (column, sum) in sums.into_iter().enumerate() {
                    sum.sub(V::splat(whole)).store(&mut output[start + phase + column * filter.period]);
                }
            }
        }
        // Near either end some taps fall outside the ping: their share of `whole` is given back.
        for (index, row) in output[..sample_count].iter_mut().enumerate() {
            let centre = (first_sample + index) * filter.decimation;
            if centre < half || centre + half >= words.len() {
                let lost = V::splat(whole - filter.inside(centre, words.len()));
                V::load(row).add(lost).store(row);
            }
        }
    }
}

/// Twice the sum of the taps at one-bits, for [`SIDE_BY_SIDE`] outputs `period` apart.
#[inline(always)]
fn ones_of<V: Vector>(
    filter: &BitFilter,
    windows: &[[u32; WORD_CHANNELS]],
    first_channel: usize,
    output: usize,
) -> [V; SIDE_BY_SIDE] {
    let stride = filter.period * filter.decimation / WINDOW_STEP;
    let mut sums = [V::splat(0.0); SIDE_BY_SIDE];
    let mut bit = output * filter.decimation;
    for table in &filter.tables {
        let (window, shift) = (bit / WINDOW_STEP, (bit % WINDOW_STEP) as u32);
        let windows = &windows[window..][..(SIDE_BY_SIDE - 1) * stride + 1];
        for (column, sum) in sums.iter_mut().enumerate() {
            let found = V::lookup(table, &windows[column * stride][first_channel..], shift);
            *sum = sum.add(found);
        }
        bit += V::LOOKUP_BITS;
    }
    sums
}

/// Bits by channel: window m holds bits 16 m to 16 m + 31 after `first` of every channel, the earliest lowest. Words outside the
/// ping are zero.
#[inline(always)]
fn sort_bits<V: Vector>(words: &[u32], first: i64, windows: &mut [[u32; WORD_CHANNELS]]) {
    const STEPS: usize = PLANE_WORDS / WINDOW_STEP;
    let mut planes = [0_u64; PLANES];
    let mut earlier = [0_u64; PLANES];
    let count = windows.len() / STEPS;
    for group in 0..=count {
        let start = first + (group * PLANE_WORDS) as i64;
        let inside = usize::try_from(start).ok().and_then(|start| words.get(start..start + PLANE_WORDS));
        match inside.and_then(|words| words.first_chunk::<PLANE_WORDS>()) {
            Some(words) => V::bit_planes(words, &mut planes),
            None => {
                let word = |index: usize| usize::try_from(start + index as i64).ok().and_then(|index| words.get(index));
                V::bit_planes(&std::array::from_fn(|index| word(index).copied().unwrap_or(0)), &mut planes);
            }
        }
        if group > 0 {
            for (step, window) in windows[(group - 1) * STEPS..][..STEPS].iter_mut().enumerate() {
                let shift = step * WINDOW_STEP;
                for ((window, earlier), later) in window.iter_mut().zip(&earlier).zip(&planes) {
                    let next = if step + 1 == STEPS { later << (PLANE_WORDS - shift) } else { 0 };
                    *window = (earlier >> shift | next) as u32;
                }
            }
        }
        earlier = planes;
    }
}
