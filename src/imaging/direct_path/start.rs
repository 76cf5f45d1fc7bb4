//! The start of a channel as the direct path needs it: thinned, and the quiet stretch before anything arrives.
//!
//! In: raw samples of any format. Out: some samples of one channel at the demodulated rate. Demodulates a few samples of one
//! channel itself, apart from the backends, so that a broken backend cannot vouch for itself. Judges nothing.

use super::template::LANES;
use crate::imaging::plan::ImagingPlan;
use crate::signal::Samples;

/// Reads samples `first`, `first + stride`, ... of one channel at the demodulated rate; `false` where the ping is too short.
pub(crate) fn read(
    plan: &ImagingPlan,
    samples: &Samples,
    channel: usize,
    first: usize,
    stride: usize,
    out: &mut [f32],
) -> bool {
    let Some(last) = out.len().checked_sub(1).map(|last| first + last * stride) else { return false };
    let offset = channel * plan.raw_count;
    match samples {
        Samples::PcmF32(values) => {
            if last >= plan.raw_count {
                return false;
            }
            let Some(row) = values.get(offset + first..=offset + last) else { return false };
            out.iter_mut().zip(row.iter().step_by(stride)).for_each(|(sample, value)| *sample = *value);
        }
        Samples::PcmI16(values) => {
            if last >= plan.raw_count {
                return false;
            }
            let Some(row) = values.get(offset + first..=offset + last) else { return false };
            let pairs = out.iter_mut().zip(row.iter().step_by(stride));
            pairs.for_each(|(sample, value)| *sample = f32::from(*value) / 32_768.0);
        }
        Samples::Pdm(words) => {
            let half = plan.demodulation_taps.len() / 2;
            if channel >= 32 || words.len() <= last * plan.decimation + half {
                return false;
            }
            for (index, sample) in out.iter_mut().enumerate() {
                let centre = (first + index * stride) * plan.decimation;
                // Taps before the first word see nothing.
                let taps = &plan.demodulation_taps[half.saturating_sub(centre)..];
                *sample = sum_of_bits(taps, &words[centre.saturating_sub(half)..][..taps.len()], channel);
            }
        }
    }
    true
}

/// Power of a quiet stretch about its mean, after a light smoothing that takes the modulator's own noise away.
pub(super) fn power(quiet: &[f32]) -> f32 {
    const SMOOTH: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let smoothed = || quiet.windows(5).map(|part| part.iter().zip(&SMOOTH).map(|(x, w)| x * w).sum::<f32>());
    let count = quiet.len().saturating_sub(4).max(1) as f32;
    let mean = smoothed().sum::<f32>() / count;
    smoothed().map(|value| (value - mean) * (value - mean)).sum::<f32>() / count
}

/// Sum of the taps, each with the sign of its word's bit of a channel: a one keeps it, a zero turns it.
fn sum_of_bits(taps: &[f32], words: &[u32], channel: usize) -> f32 {
    let signed = |tap: f32, word: u32| f32::from_bits(tap.to_bits() ^ (!word >> channel & 1) << 31);
    let mut sums = [0.0_f32; LANES];
    let (tap_chunks, word_chunks) = (taps.chunks_exact(LANES), words.chunks_exact(LANES));
    let odd = tap_chunks.remainder().iter().zip(word_chunks.remainder());
    let rest: f32 = odd.map(|(tap, word)| signed(*tap, *word)).sum();
    for (taps, words) in tap_chunks.zip(word_chunks) {
        for lane in 0..LANES {
            sums[lane] += signed(taps[lane], words[lane]);
        }
    }
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::super::tests::{plan, sensor};
    use super::*;
    use crate::signal::SampleFormat;

    #[test]
    fn words_are_demodulated_as_the_definition_says_from_the_first_on() {
        let plan = plan(&sensor(), SampleFormat::Pdm);
        let word = |n: usize| (n as u32 + 1).wrapping_mul(2_654_435_761).rotate_left(n as u32 % 29);
        let words: Vec<u32> = (0..plan.raw_count).map(word).collect();
        let samples = Samples::Pdm(words.clone());
        let mut start = vec![0.0; 240];
        for (channel, first, stride) in [(0, 0, 3), (7, 5, 1), (31, 2, 2)] {
            assert!(read(&plan, &samples, channel, first, stride, &mut start));
            for (index, sample) in start.iter().enumerate() {
                let tapped = |(tap, value): (usize, &f32)| {
                    let place = (first + index * stride) * plan.decimation + tap;
                    let word = place.checked_sub(plan.demodulation_taps.len() / 2).map(|place| words[place]);
                    word.map_or(0.0, |word| f64::from(*value) * if word >> channel & 1 == 1 { 1.0 } else { -1.0 })
                };
                let truth: f64 = plan.demodulation_taps.iter().enumerate().map(tapped).sum();
                // The taps' magnitudes sum to 1.1: rounding of 95 single-precision sums.
                assert!((f64::from(*sample) - truth).abs() < 1e-6, "sample {index}: {sample} for {truth}");
            }
        }
    }

    #[test]
    fn a_ping_that_ends_too_early_or_has_no_such_channel_is_refused() {
        let pcm = plan(&sensor(), SampleFormat::PcmF32);
        let row = Samples::PcmF32(vec![0.0; pcm.raw_count]);
        assert!(read(&pcm, &row, 0, 0, 1, &mut [0.0; 100]));
        assert!(!read(&pcm, &row, 1, 0, 1, &mut [0.0; 100]));
        assert!(!read(&pcm, &row, 0, pcm.raw_count - 50, 1, &mut [0.0; 100]), "the next row is another channel");
        let pdm = plan(&sensor(), SampleFormat::Pdm);
        assert!(!read(&pdm, &Samples::Pdm(vec![0; 999]), 0, 0, 1, &mut [0.0; 100]));
        assert!(!read(&pdm, &Samples::Pdm(vec![0; 9999]), 32, 0, 1, &mut [0.0; 100]));
    }
}
