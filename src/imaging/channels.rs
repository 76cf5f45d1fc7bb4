//! Health of the microphone channels of a raw ping, judged on the CPU by bits before any backend sees the data:
//! NaN, infinities, dead, stuck and clipped channels (specification, section 3, "Accuracy"). Channels that the direct path
//! told to be unfit ([`super::direct_path`]) are left out as well.
//!
//! In: raw samples. Out: a finding and a gain for each channel. Never changes a sample and never says what follows for the
//! robot: callers compare [`ChannelReport::clipped_count`] and [`ChannelReport::bad_count`] with the limits below.

use super::plan::{ImagingPlan, SensorPlan};
use crate::signal::Samples;

/// Clipped channels up to which they count as faulty and are left out. More are a near obstacle: they stay in the image, which must not
/// fall silent just when something is close.
pub const CLIPPED_LEFT_OUT_MAX: usize = 2;
/// Bad channels above which the image is only good enough for a degraded state.
pub const BAD_DEGRADED_ABOVE: usize = 2;
/// Bad channels above which the ping is to be rejected.
pub const BAD_REJECTED_ABOVE: usize = 8;

/// Magnitude above which a floating-point sample is none: 80 dB beyond full scale.
const SENSELESS: f32 = 1e4;
/// Full scale of floating-point samples, one step of 16 bits less.
const FULL_SCALE_F32: f32 = 32767.0 / 32768.0;
/// Samples at full scale in a row that are no coincidence.
const PCM_RUN: usize = 3;
/// Equal PDM bits in a row that no modulator makes below full scale. Simulated for first- and second-order modulators: a 25 kHz tone of amplitude
/// 0.95 makes runs of 25, one of 1.0 runs of 33 to 40; a 50 kHz tone of 1.2 runs of 32 to 70.
const PDM_RUN: usize = 32;

/// What was found of one sensor's channels, and the gain that each channel therefore gets.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelReport {
    /// Weight of each channel over the sum of the weights of all used channels; zero for a channel left out, all zeros
    /// when none is left. The matched filter multiplies with it, so an image is normalised whatever is left out.
    pub gains: Vec<f32>,
    /// Finding of each channel.
    pub findings: Vec<ChannelFinding>,
    /// What somebody else knows of each channel; counts where nothing worse is found.
    known: Vec<ChannelFinding>,
}

/// What is wrong with a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChannelFinding {
    /// Nothing.
    #[default]
    Good,
    /// Switched off in the configuration.
    Disabled,
    /// Holds a NaN, an infinity or a value far beyond full scale.
    NotFinite,
    /// All samples equal: dead or stuck.
    Stuck,
    /// At full scale later than the end of the emission + 2 ms.
    Clipped,
    /// Hears its sensor's own emission not at all, or far too faintly or loudly.
    Deaf,
    /// Far noisier than the others while nothing is to be heard yet.
    Noisy,
    /// Hears the emission when another place would.
    Misplaced,
}

impl ChannelReport {
    /// A report with equal gains and nothing found.
    #[must_use]
    pub fn new(channel_count: usize) -> Self {
        Self {
            gains: vec![1.0 / channel_count as f32; channel_count],
            findings: vec![ChannelFinding::Good; channel_count],
            known: vec![ChannelFinding::Good; channel_count],
        }
    }

    /// Sets what is known of each channel from elsewhere, for every judgement from now on; channels beyond `known` are as good as
    /// they are found.
    pub fn set_known(&mut self, known: &[ChannelFinding]) {
        self.known.fill(ChannelFinding::Good);
        self.known.iter_mut().zip(known).for_each(|(own, known)| *own = *known);
    }

    /// Judges the channels of one raw ping and sets the gains. Allocates nothing. Samples of another length than the plan's count as
    /// stuck.
    pub fn judge(&mut self, plan: &ImagingPlan, sensor_index: usize, samples: &Samples) {
        let clip_from = clip_from(plan, sensor_index);
        if samples.len() == plan.raw_len(sensor_index) {
            match samples {
                Samples::Pdm(words) => judge_words(words, clip_from).tell(&mut self.findings),
                Samples::PcmI16(values) => {
                    let rows = self.findings.iter_mut().zip(values.chunks_exact(plan.raw_count));
                    rows.for_each(|(finding, row)| *finding = judge_i16(row, clip_from));
                }
                Samples::PcmF32(values) => {
                    let rows = self.findings.iter_mut().zip(values.chunks_exact(plan.raw_count));
                    rows.for_each(|(finding, row)| *finding = judge_f32(row, clip_from));
                }
            }
        } else {
            self.findings.fill(ChannelFinding::Stuck);
        }
        self.set_gains(&plan.sensors[sensor_index]);
    }

    /// Sets the gains that follow from the findings; disabled channels are found to be so.
    pub(super) fn set_gains(&mut self, sensor: &SensorPlan) {
        for (finding, weight) in self.findings.iter_mut().zip(&sensor.weights) {
            if *weight == 0.0 {
                *finding = ChannelFinding::Disabled;
            }
        }
        for (finding, known) in self.findings.iter_mut().zip(&self.known) {
            if *finding == ChannelFinding::Good {
                *finding = *known;
            }
        }
        let keep_clipped = self.clipped_count() > CLIPPED_LEFT_OUT_MAX;
        let used = |finding: &ChannelFinding| match finding {
            ChannelFinding::Good => true,
            ChannelFinding::Clipped => keep_clipped,
            _ => false,
        };
        let weights = || self.findings.iter().zip(&sensor.weights);
        let total: f32 = weights().filter(|(finding, _)| used(finding)).map(|(_, weight)| *weight).sum();
        for ((gain, finding), weight) in self.gains.iter_mut().zip(&self.findings).zip(&sensor.weights) {
            *gain = if used(finding) && total > 0.0 { weight / total } else { 0.0 };
        }
    }

    /// Channels clipped after the direct path. More than [`CLIPPED_LEFT_OUT_MAX`] are a near obstacle.
    #[must_use]
    pub fn clipped_count(&self) -> usize {
        self.findings.iter().filter(|finding| **finding == ChannelFinding::Clipped).count()
    }

    /// Channels left out for a fault: not finite, stuck, unfit by the direct path, and clipped ones unless so many are clipped that it means a near obstacle.
    #[must_use]
    pub fn bad_count(&self) -> usize {
        let faulty = |finding: &&ChannelFinding| {
            !matches!(finding, ChannelFinding::Good | ChannelFinding::Disabled | ChannelFinding::Clipped)
        };
        let clipped = self.clipped_count();
        let clipped = if clipped > CLIPPED_LEFT_OUT_MAX { 0 } else { clipped };
        self.findings.iter().filter(faulty).count() + clipped
    }

    /// Channels that the image is made of.
    #[must_use]
    pub fn used_count(&self) -> usize {
        self.gains.iter().filter(|gain| **gain > 0.0).count()
    }
}

/// First raw sample of a channel from which clipping counts.
pub(super) fn clip_from(plan: &ImagingPlan, sensor_index: usize) -> usize {
    let rate_hz = plan.sample_rate_hz * plan.decimation as f64;
    ((plan.sensors[sensor_index].clip_after_s * rate_hz).ceil() as usize).min(plan.raw_count)
}

#[inline(always)]
fn finding(not_finite: bool, stuck: bool, clipped: bool) -> ChannelFinding {
    if not_finite {
        ChannelFinding::NotFinite
    } else if stuck {
        ChannelFinding::Stuck
    } else if clipped {
        ChannelFinding::Clipped
    } else {
        ChannelFinding::Good
    }
}

/// Bits of a magnitude as an integer: it orders like the magnitude, with infinities and NaN on top.
#[inline(always)]
fn magnitude_bits(value: f32) -> i32 {
    (value.to_bits() & 0x7fff_ffff) as i32
}

/// Judges one channel.
#[inline(always)]
pub(super) fn judge_f32(row: &[f32], clip_from: usize) -> ChannelFinding {
    let first = row.first().map_or(0, |value| value.to_bits());
    let senseless = magnitude_bits(SENSELESS);
    let (mut beyond, mut differing, mut any) = (0_i32, 0_u32, 0_i32);
    for value in row {
        let bits = magnitude_bits(*value);
        beyond |= i32::from(bits > senseless);
        differing |= value.to_bits() ^ first;
        any |= bits;
    }
    let full = magnitude_bits(FULL_SCALE_F32);
    // Zeros of either sign are one value.
    finding(beyond != 0, differing == 0 || any == 0, has_run(&row[clip_from..], |value| magnitude_bits(value) >= full))
}

/// Judges one channel.
#[inline(always)]
pub(super) fn judge_i16(row: &[i16], clip_from: usize) -> ChannelFinding {
    let first = row.first().copied().unwrap_or(0);
    let differing = row.iter().fold(0, |differing, value| differing | (value ^ first));
    let full = |value: i16| (value == i16::MAX) | (value <= -i16::MAX);
    finding(false, differing == 0, has_run(&row[clip_from..], full))
}

/// Whether [`PCM_RUN`] values in a row are at full scale; without branches in the loop, since it runs over every sample of every ping.
#[inline(always)]
fn has_run<T: Copy>(row: &[T], full: impl Fn(T) -> bool) -> bool {
    let count = (row.len() + 1).saturating_sub(PCM_RUN);
    if count == 0 {
        return false;
    }
    let (a, b, c) = (&row[..count], &row[1..][..count], &row[PCM_RUN - 1..][..count]);
    let mut found = 0_i32;
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        found |= i32::from(full(*a) & full(*b) & full(*c));
    }
    found != 0
}

/// What was found in some words, a bit a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct WordFindings {
    /// All bits were ones.
    ones: u32,
    /// Some bit was one.
    any: u32,
    /// [`PDM_RUN`] equal bits in a row.
    clipped: u32,
}

impl WordFindings {
    /// Of no words.
    pub(super) const NONE: WordFindings = WordFindings { ones: u32::MAX, any: 0, clipped: 0 };

    /// Of these words and those of `other`. Runs that begin in one and end in the other are in neither: pieces must overlap.
    pub(super) fn and(self, other: Self) -> Self {
        Self { ones: self.ones & other.ones, any: self.any | other.any, clipped: self.clipped | other.clipped }
    }

    /// Says so channel by channel.
    pub(super) fn tell(self, findings: &mut [ChannelFinding]) {
        let stuck = self.ones | !self.any;
        for (channel, found) in findings.iter_mut().enumerate() {
            let bit = |bits: u32| bits >> channel & 1 == 1;
            *found = finding(false, bit(stuck), bit(self.clipped));
        }
    }
}

/// Words by which two pieces must overlap.
pub(super) const WORDS_OVERLAP: usize = PDM_RUN - 1;

/// Judges some words of all channels; runs count from `clip_from` on.
#[inline(always)]
pub(super) fn judge_words(words: &[u32], clip_from: usize) -> WordFindings {
    let (ones, any) = words.iter().fold((u32::MAX, 0), |(ones, any), word| (ones & word, any | word));
    WordFindings { ones, any, clipped: long_runs(&words[clip_from.min(words.len())..]) }
}

/// Words of one step of the search for runs.
const STEP: usize = 1024;

/// Bits that stay equal over [`PDM_RUN`] words somewhere. Runs double from pass to pass: a run of 2 n begins where a run of n is followed
/// by another.
#[inline(always)]
fn long_runs(words: &[u32]) -> u32 {
    let mut runs = [0_u32; STEP + PDM_RUN];
    let mut found = 0;
    let mut start = 0;
    while start + PDM_RUN <= words.len() {
        let block = &words[start..words.len().min(start + STEP + PDM_RUN - 1)];
        let mut count = block.len() - 1;
        for (run, pair) in runs.iter_mut().zip(block.windows(2)) {
            *run = !(pair[0] ^ pair[1]);
        }
        // `runs[i]` holds for `have` equal neighbours from i on; PDM_RUN - 1 of them are wanted.
        let mut have = 1;
        while have < PDM_RUN - 1 {
            let more = have.min(PDM_RUN - 1 - have);
            count -= more;
            for index in 0..count {
                runs[index] &= runs[index + more];
            }
            have += more;
        }
        found = runs[..count].iter().fold(found, |found, run| found | run);
        start += STEP;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_found_wherever_it_starts_and_a_shorter_one_is_not() {
        for length in [PDM_RUN, PDM_RUN + 1, STEP - 1, STEP, 3 * STEP + 17] {
            for place in (0..=length - PDM_RUN).step_by(13).chain([length - PDM_RUN]) {
                // Channel 0 alternates; channel 5 is equal for exactly PDM_RUN words; channel 9 for one less.
                let word = |index: usize| {
                    let alternating = (index as u32 & 1) * u32::MAX;
                    let inside = |run: usize| (place..place + run).contains(&index);
                    let channel = |k: u32, run: usize| if inside(run) { 1 << k } else { alternating & 1 << k };
                    let other = alternating & !(1 << 5 | 1 << 9);
                    other | channel(5, PDM_RUN) | channel(9, PDM_RUN - 2)
                };
                let words: Vec<u32> = (0..length).map(word).collect();
                assert_eq!(long_runs(&words), 1 << 5, "{length} words, run from {place}");
            }
        }
        assert_eq!(long_runs(&[0; PDM_RUN - 1]), 0);
    }

    #[test]
    fn nan_infinity_and_senseless_values_are_found_at_any_place() {
        for place in [0, 1, 500, 998, 999] {
            for value in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -2e4] {
                let mut row: Vec<f32> = (0..1000).map(|n| (n as f32).sin() * 0.1).collect();
                assert_eq!(judge_f32(&row, 100), ChannelFinding::Good);
                row[place] = value;
                assert_eq!(judge_f32(&row, 100), ChannelFinding::NotFinite, "{value} at {place}");
            }
        }
    }

    #[test]
    fn constant_rows_are_stuck_zeros_of_either_sign_among_them() {
        assert_eq!(judge_f32(&[0.25; 64], 10), ChannelFinding::Stuck);
        assert_eq!(judge_f32(&[0.0, -0.0, 0.0, 0.0], 1), ChannelFinding::Stuck);
        assert_eq!(judge_f32(&[0.25, 0.250_001, 0.25], 1), ChannelFinding::Good);
        assert_eq!(judge_i16(&[-3; 64], 10), ChannelFinding::Stuck);
        assert_eq!(judge_i16(&[-3, -3, -2], 1), ChannelFinding::Good);
    }

    #[test]
    fn clipping_counts_only_after_the_direct_path_and_only_in_a_row() {
        let row = |places: &[usize]| {
            let mut row: Vec<i16> = (0..200).map(|n| (n % 7) as i16).collect();
            places.iter().for_each(|place| row[*place] = if place % 2 == 0 { 32767 } else { -32768 });
            row
        };
        assert_eq!(judge_i16(&row(&[50, 51, 52]), 100), ChannelFinding::Good);
        assert_eq!(judge_i16(&row(&[150, 152, 154]), 100), ChannelFinding::Good);
        assert_eq!(judge_i16(&row(&[150, 151, 152]), 100), ChannelFinding::Clipped);
        assert_eq!(judge_i16(&row(&[197, 198, 199]), 100), ChannelFinding::Clipped);
        let floats: Vec<f32> = row(&[150, 151, 152]).iter().map(|x| f32::from(*x) / 32768.0).collect();
        assert_eq!(judge_f32(&floats, 100), ChannelFinding::Clipped);
    }

    #[test]
    fn gains_of_the_channels_left_sum_to_one() {
        let sensor = SensorPlan {
            channel_count: 5,
            weights: vec![1.0, 2.0, 0.0, 1.0, 1.0],
            delays_s: std::sync::Arc::new(vec![0.0; 5]),
            hidden: vec![false],
            steering_of: 0,
            reference: std::sync::Arc::default(),
            clip_after_s: 0.0,
        };
        let mut report = ChannelReport::new(5);
        let mut gains = |findings: [ChannelFinding; 5]| {
            report.findings.copy_from_slice(&findings);
            report.set_gains(&sensor);
            (report.gains.clone(), report.bad_count(), report.clipped_count())
        };
        use ChannelFinding::{Clipped, Good, NotFinite, Stuck};
        assert_eq!(gains([Good; 5]), (vec![0.2, 0.4, 0.0, 0.2, 0.2], 0, 0));
        assert_eq!(gains([Stuck, Good, Stuck, Clipped, Good]), (vec![0.0, 2.0 / 3.0, 0.0, 0.0, 1.0 / 3.0], 2, 1));
        // Three clipped channels are a near obstacle and stay.
        assert_eq!(gains([Clipped, Clipped, Good, Clipped, Good]), (vec![0.2, 0.4, 0.0, 0.2, 0.2], 0, 3));
        assert_eq!(gains([NotFinite, Stuck, Good, Stuck, NotFinite]), (vec![0.0; 5], 4, 0));
    }
}
