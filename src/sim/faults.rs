//! What broken sensors deliver: a ping set in, the same set out as it would have come with a fault.
//!
//! Knows raw samples, numbers and stamps only: not what a fault means and not what is to be done about it. Everything random comes
//! from the seed, so that the same faults on the same pings give the same bits. PDM is spoilt bit by bit, PCM value by value. For
//! tests, drills and the soak; no live source passes through here.

use crate::signal::{PingSet, Samples};
use crate::time::Stamp;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// PDM words over which an overdriven microphone says the same.
const OVERDRIVEN_WORDS: usize = 16;
/// How far a number steps back in [`Fault::Backward`].
const STEP_BACK: u64 = 10;

/// What is wrong with a sensor, from the set on for which it is set until it is cleared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// Nothing but white noise of this standard deviation, new in every ping.
    EmitterDead {
        /// Standard deviation, full scale 1.
        rms: f32,
    },
    /// Words or samples that are all zero.
    Zeros,
    /// The samples of the first faulty set again and again, under new numbers and stamps.
    Frozen,
    /// Nothing arrives.
    Dropped,
    /// All channels amplified by `gain` and cut at full scale.
    Clipped {
        /// Amplification.
        gain: f32,
    },
    /// The first `count` channels are silent.
    DeadChannels {
        /// Channels.
        count: usize,
    },
    /// The first `count` channels stay at full scale.
    StuckChannels {
        /// Channels.
        count: usize,
    },
    /// White noise on top of the first `count` channels; in PDM, noise instead of them.
    HotChannels {
        /// Channels.
        count: usize,
        /// Standard deviation, full scale 1.
        rms: f32,
    },
    /// Channels 0 and 1, 2 and 3 and so on are exchanged, `pairs` times.
    SwappedChannels {
        /// Pairs.
        pairs: usize,
    },
    /// Sampled at `ratio` times the rate that the configuration says.
    RateError {
        /// Wrong rate over right rate, 0.5 to 2.
        ratio: f64,
    },
    /// Stamped so much later than the others.
    Desync {
        /// Delay.
        late_ns: u64,
    },
    /// So many numbers are left out before every ping; they stay left out when the fault is over.
    Gaps {
        /// Numbers.
        missing: u64,
    },
    /// Every ping under the number of the last good one.
    Duplicate,
    /// Every ping under a number that was used long before.
    Backward,
    /// Stamped ahead of time.
    Future {
        /// So much.
        ahead_ns: u64,
    },
    /// Stamped behind time.
    Past {
        /// So much.
        behind_ns: u64,
    },
}

impl Fault {
    /// A word for reports.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Fault::EmitterDead { .. } => "emitter-dead",
            Fault::Zeros => "zeros",
            Fault::Frozen => "frozen",
            Fault::Dropped => "dropped",
            Fault::Clipped { .. } => "clipped",
            Fault::DeadChannels { .. } => "dead-channels",
            Fault::StuckChannels { .. } => "stuck-channels",
            Fault::HotChannels { .. } => "hot-channels",
            Fault::SwappedChannels { .. } => "swapped-channels",
            Fault::RateError { .. } => "rate-error",
            Fault::Desync { .. } => "desync",
            Fault::Gaps { .. } => "gaps",
            Fault::Duplicate => "duplicate",
            Fault::Backward => "backward",
            Fault::Future { .. } => "future-stamp",
            Fault::Past { .. } => "past-stamp",
        }
    }
}

#[derive(Debug, Clone)]
struct Sensor {
    channel_count: usize,
    fault: Option<Fault>,
    /// Samples of the first faulty set, while frozen; made with the first set, so that later ones allocate nothing.
    kept: Option<Samples>,
    keeps: bool,
    /// Number of the last set without a fault.
    last_number: u64,
    left_out: u64,
}

/// Spoils ping sets.
#[derive(Debug, Clone)]
pub struct Faults {
    sensors: Vec<Sensor>,
    random: ChaCha8Rng,
    scratch: Vec<f32>,
}

impl Faults {
    /// No fault yet, for sensors with so many channels each; `seed` decides all noise.
    #[must_use]
    pub fn new(channel_counts: &[usize], seed: u64) -> Self {
        let sensor = |count: &usize| Sensor {
            channel_count: (*count).max(1),
            fault: None,
            kept: None,
            keeps: false,
            last_number: 0,
            left_out: 0,
        };
        Self {
            sensors: channel_counts.iter().map(sensor).collect(),
            random: ChaCha8Rng::seed_from_u64(seed),
            scratch: Vec::new(),
        }
    }

    /// From the next set on a sensor has this fault instead of the one it had; `None` heals it. No sensor, no fault.
    pub fn set(&mut self, sensor_index: usize, fault: Option<Fault>) {
        if let Some(sensor) = self.sensors.get_mut(sensor_index) {
            sensor.fault = fault;
            sensor.keeps = false;
        }
    }

    /// Heals all sensors.
    pub fn clear(&mut self) {
        (0..self.sensors.len()).for_each(|index| self.set(index, None));
    }

    /// Spoils a set, and says whether anything of it is other than it was.
    pub fn apply(&mut self, pings: &mut PingSet) -> bool {
        let mut changed = false;
        for index in 0..self.sensors.len().min(pings.pings.len()) {
            if pings.present[index] {
                changed |= self.apply_to(index, pings);
            }
        }
        if let Some(oldest) = pings.iter_present().map(|ping| ping.emitted_at).min() {
            pings.emitted_at = oldest;
        }
        changed
    }

    fn apply_to(&mut self, index: usize, pings: &mut PingSet) -> bool {
        let Self { sensors, random, scratch } = self;
        let sensor = &mut sensors[index];
        let ping = &mut pings.pings[index];
        let number = ping.sequence.wrapping_add(sensor.left_out);
        ping.sequence = number;
        let Some(fault) = sensor.fault else {
            sensor.last_number = number;
            if sensor.kept.is_none() {
                sensor.kept = Some(Samples::clone(&ping.samples));
                scratch.reserve(ping.samples.len());
            }
            return false;
        };
        let channels = sensor.channel_count;
        match fault {
            Fault::EmitterDead { rms } => noise(ping.samples_mut(), channels, rms, random),
            Fault::Zeros => match ping.samples_mut() {
                Samples::Pdm(words) => words.fill(0),
                Samples::PcmI16(values) => values.fill(0),
                Samples::PcmF32(values) => values.fill(0.0),
            },
            Fault::Frozen => match &mut sensor.kept {
                Some(kept) if sensor.keeps => copy(kept, ping.samples_mut()),
                kept => {
                    // The first set is the one that the next ones repeat; nothing is wrong with it yet.
                    copy(&ping.samples, kept.get_or_insert_with(|| Samples::clone(&ping.samples)));
                    sensor.keeps = true;
                    return false;
                }
            },
            Fault::Dropped => pings.present[index] = false,
            Fault::Clipped { gain } => overdrive(ping.samples_mut(), channels, gain),
            Fault::DeadChannels { count } => set_channels(ping.samples_mut(), channels, count, 0.0),
            Fault::StuckChannels { count } => set_channels(ping.samples_mut(), channels, count, 1.0),
            Fault::HotChannels { count, rms } => heat(ping.samples_mut(), channels, count, rms, random),
            Fault::SwappedChannels { pairs } => swap_channels(ping.samples_mut(), channels, pairs),
            Fault::RateError { ratio } => resample(ping.samples_mut(), channels, ratio, scratch),
            Fault::Desync { late_ns } | Fault::Future { ahead_ns: late_ns } => {
                ping.emitted_at = ping.emitted_at.plus_ns(late_ns);
            }
            Fault::Past { behind_ns } => {
                let Stamp { boottime_ns, wall_ns } = ping.emitted_at;
                let earlier = |at_ns: u64| at_ns.saturating_sub(behind_ns);
                ping.emitted_at = Stamp { boottime_ns: earlier(boottime_ns), wall_ns: earlier(wall_ns) };
            }
            Fault::Gaps { missing } => {
                sensor.left_out = sensor.left_out.wrapping_add(missing);
                ping.sequence = number.wrapping_add(missing);
            }
            Fault::Duplicate => ping.sequence = sensor.last_number,
            Fault::Backward => ping.sequence = sensor.last_number.wrapping_sub(STEP_BACK),
        }
        true
    }
}

/// Copies samples into a buffer that most often has their size already.
fn copy(from: &Samples, to: &mut Samples) {
    match (from, to) {
        (Samples::Pdm(from), Samples::Pdm(to)) => to.clone_from(from),
        (Samples::PcmI16(from), Samples::PcmI16(to)) => to.clone_from(from),
        (Samples::PcmF32(from), Samples::PcmF32(to)) => to.clone_from(from),
        (from, to) => *to = from.clone(),
    }
}

fn full_scale_i16(value: f32) -> i16 {
    (value * 32768.0).round().clamp(-32768.0, 32767.0) as i16
}

/// Changes values of the first `count` channels of PCM; leaves PDM alone.
fn change(samples: &mut Samples, channels: usize, count: usize, mut with: impl FnMut(f32) -> f32) {
    let first = |len: usize| (len / channels).saturating_mul(count.min(channels));
    match samples {
        Samples::Pdm(_) => {}
        Samples::PcmI16(values) => {
            let end = first(values.len());
            values[..end].iter_mut().for_each(|value| *value = full_scale_i16(with(f32::from(*value) / 32768.0)));
        }
        Samples::PcmF32(values) => {
            let end = first(values.len());
            values[..end].iter_mut().for_each(|value| *value = with(*value));
        }
    }
}

/// The bits of the first `count` channels.
fn bits(count: usize) -> u32 {
    if count >= 32 { u32::MAX } else { (1 << count) - 1 }
}

fn uniform(random: &mut ChaCha8Rng, rms: f32) -> f32 {
    rms * 12_f32.sqrt() * (random.random::<f32>() - 0.5)
}

fn noise(samples: &mut Samples, channels: usize, rms: f32, random: &mut ChaCha8Rng) {
    let Samples::Pdm(words) = samples else {
        change(samples, channels, channels, |_| uniform(random, rms));
        return;
    };
    // A first-order modulator for each channel, fed with noise.
    let mut sums = [0.0_f32; 32];
    for word in words {
        *word = 0;
        for (bit, sum) in sums.iter_mut().enumerate().take(channels) {
            *sum += uniform(random, rms);
            if *sum >= 0.0 {
                *word |= 1 << bit;
                *sum -= 1.0;
            } else {
                *sum += 1.0;
            }
        }
    }
}

fn set_channels(samples: &mut Samples, channels: usize, count: usize, to: f32) {
    if let Samples::Pdm(words) = samples {
        let mask = bits(count.min(channels));
        for (n, word) in words.iter_mut().enumerate() {
            // Silence alternates; full scale is all ones.
            let ones = to > 0.0 || n % 2 == 0;
            *word = *word & !mask | if ones { mask } else { 0 };
        }
    }
    change(samples, channels, count, |_| to);
}

fn heat(samples: &mut Samples, channels: usize, count: usize, rms: f32, random: &mut ChaCha8Rng) {
    if let Samples::Pdm(words) = samples {
        let mask = bits(count.min(channels));
        words.iter_mut().for_each(|word| *word = *word & !mask | random.random::<u32>() & mask);
    }
    change(samples, channels, count, |value| (value + uniform(random, rms)).clamp(-1.0, 1.0));
}

fn overdrive(samples: &mut Samples, channels: usize, gain: f32) {
    if let Samples::Pdm(words) = samples {
        for block in words.chunks_mut(OVERDRIVEN_WORDS) {
            let majority = |bit: usize| {
                let ones = block.iter().filter(|word| **word >> bit & 1 == 1).count();
                u32::from(2 * ones > block.len()) << bit
            };
            let said = (0..channels.min(32)).fold(0, |word, bit| word | majority(bit));
            block.fill(said);
        }
    }
    change(samples, channels, channels, |value| (value * gain).clamp(-1.0, 1.0));
}

fn swap_channels(samples: &mut Samples, channels: usize, pairs: usize) {
    fn swap_rows<T>(values: &mut [T], channels: usize, pairs: usize) {
        let row = values.len() / channels;
        for pair in values[..row * channels].chunks_exact_mut(2 * row.max(1)).take(pairs) {
            let (a, b) = pair.split_at_mut(row);
            a.swap_with_slice(b);
        }
    }
    match samples {
        Samples::Pdm(words) => {
            let mask = bits(2 * pairs.min(channels / 2));
            for word in words {
                let swapped = (*word & 0x5555_5555) << 1 | (*word >> 1) & 0x5555_5555;
                *word = *word & !mask | swapped & mask;
            }
        }
        Samples::PcmI16(values) => swap_rows(values, channels, pairs),
        Samples::PcmF32(values) => swap_rows(values, channels, pairs),
    }
}

/// Samples later the larger `ratio`: what a clock that is too slow would have read. The end repeats the last sample.
fn resample(samples: &mut Samples, channels: usize, ratio: f64, scratch: &mut Vec<f32>) {
    let ratio = if ratio.is_finite() { ratio.clamp(0.5, 2.0) } else { 1.0 };
    if let Samples::Pdm(words) = samples {
        let old = words.clone();
        for (n, word) in words.iter_mut().enumerate() {
            *word = old[((n as f64 * ratio) as usize).min(old.len() - 1)];
        }
        return;
    }
    scratch.clear();
    change(samples, channels, channels, |value| {
        scratch.push(value);
        value
    });
    let row = scratch.len() / channels;
    let mut at = 0;
    change(samples, channels, channels, |_| {
        let (channel, n) = (at / row, at % row);
        at += 1;
        let place = (n as f64 * ratio).min((row - 1) as f64);
        let (left, part) = (place as usize, place.fract() as f32);
        let line = &scratch[channel * row..][..row];
        line[left] + part * (line[(left + 1).min(row - 1)] - line[left])
    });
}
