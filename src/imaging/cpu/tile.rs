//! PCM samples of one block of channels side by side: `[channel][sample]` to `[sample][lane]`, lanes being channels.
//!
//! In: a stretch of samples. Out: one vector a sample; lanes without a channel are zero. Never weighs or judges channels.

use super::aligned::rows_mut;
use super::simd::Vector;

/// Raw PCM, `[channel][sample]`.
#[derive(Clone, Copy)]
pub(super) enum Pcm<'a> {
    F32(&'a [f32]),
    /// Full scale 32768.
    I16(&'a [i16]),
}

/// One stretch of one block.
pub(super) struct TileTask<'a> {
    pub pcm: Pcm<'a>,
    /// Samples of one channel.
    pub sample_count: usize,
    /// First channel of the block.
    pub first_channel: usize,
    pub channel_count: usize,
    /// First sample.
    pub first: usize,
    /// `[sample][lane]`: as many samples as it has rows, all of which exist.
    pub tile: &'a mut [f32],
}

/// Squares read at once from every channel: channels lie whole pages apart, so that a cache line of each would be pushed out by the
/// others' before its neighbour is read.
const SQUARES: usize = 16;

/// Fills the tile.
#[inline(always)]
pub(super) fn fill<V: Vector>(task: TileTask<'_>) {
    let TileTask { pcm, sample_count, first_channel, channel_count, first, tile } = task;
    let channels = first_channel..channel_count.min(first_channel + V::LANES);
    let tile = rows_mut::<V>(tile);
    let row = |channel: usize, start: usize, count: usize| {
        let place = channel * sample_count + first + start;
        place..place + count
    };
    // From the first cache line on, whole lines are read.
    let lead = match pcm {
        Pcm::F32(values) => values[row(first_channel, 0, 0).start..].as_ptr().align_offset(64),
        Pcm::I16(_) => 0,
    };
    let mut start = 0;
    while start < tile.len() {
        let rest = tile.len() - start;
        let count = if start == 0 && (1..rest).contains(&lead) { lead } else { rest.min(SQUARES * V::LANES) };
        let whole = count / V::LANES * V::LANES;
        let (squares, odd) = tile[start..start + count].split_at_mut(whole);
        for (lane, channel) in channels.clone().enumerate() {
            // Both formats spelt out: one loop that was handed the conversion was not compiled for the instruction set, and six times slower.
            match pcm {
                Pcm::F32(values) => {
                    let values = &values[row(channel, start, count)];
                    for (square, values) in squares.chunks_exact_mut(V::LANES).zip(values.chunks_exact(V::LANES)) {
                        square[lane].as_mut().copy_from_slice(values);
                    }
                    odd.iter_mut().zip(&values[whole..]).for_each(|(row, value)| row.as_mut()[lane] = *value);
                }
                Pcm::I16(values) => {
                    let values = &values[row(channel, start, count)];
                    for (square, values) in squares.chunks_exact_mut(V::LANES).zip(values.chunks_exact(V::LANES)) {
                        let samples = square[lane].as_mut().iter_mut();
                        samples.zip(values).for_each(|(sample, value)| *sample = full_scale(*value));
                    }
                    odd.iter_mut()
                        .zip(&values[whole..])
                        .for_each(|(row, value)| row.as_mut()[lane] = full_scale(*value));
                }
            }
        }
        for lane in channels.len()..V::LANES {
            squares.chunks_exact_mut(V::LANES).for_each(|square| square[lane] = V::ROW_OF_ZEROS);
            odd.iter_mut().for_each(|row| row.as_mut()[lane] = 0.0);
        }
        squares.chunks_exact_mut(V::LANES).for_each(V::transpose);
        start += count;
    }
}

/// 16-bit PCM to full scale 1.
#[inline(always)]
pub(super) fn full_scale(value: i16) -> f32 {
    f32::from(value) * (1.0 / 32768.0)
}
