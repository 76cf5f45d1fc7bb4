//! PDM words to PCM: a low-pass FIR on bits that count as +1 and -1, decimated, its delay compensated (specification, section 2).
//!
//! In: words of one sensor, bit k = channel k. Out: `[channel][sample]`, full scale 1. PCM needs no demodulation; 16-bit
//! values are brought to full scale 1 here. Twin of `shaders/demodulate.wgsl`. Never judges channels.

use super::simd::Vector;

/// Channels of a PDM word.
pub(super) const WORD_CHANNELS: usize = 32;

/// A piece of a ping: outputs `first_sample .. first_sample + sample_count` of all channels.
pub(super) struct DemodulateTask<'a> {
    /// The plan's FIR.
    pub taps: &'a [f32],
    /// Words per sample.
    pub decimation: usize,
    /// Words from `first_word` of the ping on, all that the outputs need and the ping has.
    pub words: &'a [u32],
    /// Place of `words[0]` in the ping.
    pub first_word: usize,
    /// First output.
    pub first_sample: usize,
    /// Number of outputs.
    pub sample_count: usize,
    /// Number of channels to write.
    pub channel_count: usize,
    /// `[channel][sample]` of this piece.
    pub output: &'a mut [f32],
}

/// Words that the outputs `first .. first + count` reach, clipped to a ping of `word_count` words.
pub(super) fn words_needed(
    first: usize,
    count: usize,
    decimation: usize,
    taps: usize,
    word_count: usize,
) -> std::ops::Range<usize> {
    let half = taps / 2;
    let end = ((first + count - 1) * decimation + half + 1).min(word_count);
    (first * decimation).saturating_sub(half).min(end)..end
}

/// Outputs computed side by side: enough independent sums to hide the latency of an addition.
const SIDE_BY_SIDE: usize = 4;

/// Demodulates one piece.
#[inline(always)]
pub(super) fn demodulate<V: Vector>(task: DemodulateTask<'_>) {
    let half = task.taps.len() / 2;
    let total: f32 = task.taps.iter().sum();
    let word_end = task.first_word + task.words.len();
    let mut ones = [[0.0_f32; WORD_CHANNELS]; SIDE_BY_SIDE];
    let mut index = 0;
    while index < task.sample_count {
        let centre = (task.first_sample + index) * task.decimation;
        let last_centre = centre + (SIDE_BY_SIDE - 1) * task.decimation;
        let whole = centre >= half + task.first_word
            && last_centre + half < word_end
            && index + SIDE_BY_SIDE <= task.sample_count;
        let (columns, inside) = if whole {
            let start = centre - half - task.first_word;
            ones_of::<V, SIDE_BY_SIDE>(&task.words[start..], task.taps, task.decimation, &mut ones);
            (SIDE_BY_SIDE, total)
        } else {
            // Words outside the ping count as zero, neither +1 nor -1: the taps that fall there drop out.
            let tap_first = (half + task.first_word).saturating_sub(centre);
            let tap_end = task.taps.len().min((word_end + half).saturating_sub(centre));
            let taps = &task.taps[tap_first.min(tap_end)..tap_end];
            let start = (centre + tap_first).saturating_sub(half + task.first_word).min(task.words.len());
            ones_of::<V, 1>(&task.words[start..], taps, 0, &mut ones);
            (1, taps.iter().sum())
        };
        for (column, ones) in ones[..columns].iter().enumerate() {
            for (channel, ones) in ones[..task.channel_count].iter().enumerate() {
                task.output[channel * task.sample_count + index + column] = 2.0 * ones - inside;
            }
        }
        index += columns;
    }
}

/// Sum of the taps at the one-bits of every channel, for `N` outputs `stride` words apart.
#[inline(always)]
fn ones_of<V: Vector, const N: usize>(words: &[u32], taps: &[f32], stride: usize, ones: &mut [[f32; WORD_CHANNELS]]) {
    let words = &words[..stride * (N - 1) + taps.len()];
    let mut first = 0;
    while first < WORD_CHANNELS {
        let mut sums = [[V::splat(0.0); 2]; N];
        for (index, tap) in taps.iter().enumerate() {
            let tap = V::splat(*tap);
            for column in 0..N {
                let bits = words[index + column * stride] >> first;
                sums[column][0] = sums[column][0].add_where(bits, tap);
                sums[column][1] = sums[column][1].add_where(bits >> V::LANES, tap);
            }
        }
        for column in 0..N {
            sums[column][0].store(&mut ones[column][first..]);
            sums[column][1].store(&mut ones[column][first + V::LANES..]);
        }
        first += 2 * V::LANES;
    }
}

/// 16-bit PCM of one channel to full scale 1.
pub(super) fn full_scale(values: &[i16], output: &mut [f32]) {
    for (output, value) in output.iter_mut().zip(values) {
        *output = f32::from(*value) * (1.0 / 32768.0);
    }
}
