//! The direct path of one sensor: what is remembered of its channels from ping to ping, and the verdict on all of them.
//!
//! In: raw samples. Out: [`DirectFindings`], unfit channels, calibration. Delays are compared by phase where a channel is heard about
//! where it should be (a hundredth of a period is 0.1 mm), by looking through all lags where it is not. A phase that all
//! channels share is a property of the transducers; whether all are late is told by the envelope.

use super::channel::{Channel, QUIET_MARGIN, Told, is_alive, is_flat};
use super::pattern::{self, Arrival, Calibration};
use super::start;
use super::template::{Correlation, Template};
use super::{ChannelMap, DirectFindings, HEARD_MIN};
use crate::imaging::channels::ChannelFinding;
use crate::imaging::plan::ImagingPlan;
use crate::sensor::SensorSetup;
use crate::signal::{SampleFormat, Samples};
use nalgebra::{Complex, Vector3};
use std::f64::consts::PI;
use std::sync::Arc;

/// Channels heard in a ping, of those in use.
const PCM_CHANNELS: usize = 32;
const PDM_CHANNELS: usize = 8;
/// Channels whose envelope is compared with its flanks in a ping.
const FLANKED: usize = 4;
/// Channels for which all lags are looked through in a ping.
const SEARCHES: usize = 4;
/// Channels that are asked whether anything is heard at all where nothing is where it should be.
const WITNESSES: usize = 3;
/// A channel whose coefficient is below this share of the median is not where it should be.
const MISPLACED_SHARE: f32 = 0.7;
/// And does not hear if all lags give no more than this share.
const DEAF_SHARE: f32 = 0.5;
/// Median coefficient below which delays say nothing of the array: something else is louder.
const CLEAR_MIN: f32 = 0.4;
/// Direct path, against what distance and the other channels make of it: a microphone is deaf or over-driven by 14 dB.
const STRENGTH: std::ops::Range<f32> = 0.2..5.0;
/// Noise power of a channel over that of the quieter ones (14 dB) from which the channel is broken.
const NOISY: f32 = 25.0;
/// Noise power below which no channel is called noisy: -57 dB of full scale.
const NOISE_FLOOR: f32 = 2e-6;
/// Channels that may be looked for without a doubt of the others.
const PENDING_MAX: usize = 2;
/// Rounds through all channels after which a doubt is certain.
const CERTAIN_ROUNDS: u32 = 3;
/// Share of the shift that a sample rate wrong by 1 % makes from which the emission counts as late.
const LATE_SHARE: f64 = 0.6;
/// Lags beyond those of the array that are looked through, in samples at 450 kHz: a tenth of a millisecond in all.
const REACH_S: f64 = 50e-6;
/// Step of the search, a share of the template's flank.
const SEARCH_STEP_SHARE: i64 = 2;

#[derive(Debug, Clone)]
pub(super) struct SensorPath {
    template: Arc<Template>,
    channels: Vec<Channel>,
    emitter_m: Vector3<f64>,
    speed_of_sound_m_s: f64,
    rate_hz: f64,
    /// Channels heard in a ping.
    batch: usize,
    next: usize,
    next_search: usize,
    next_flank: usize,
    /// By how much the emission was last found late on all channels, in whole samples.
    shift: i64,
    /// First and last lag that is looked at in a search.
    lags: (i64, i64),
    /// All channels, neighbours in the list far apart in the array's numbering.
    witnesses: Vec<usize>,
    map: ChannelMap,
    doubts: u32,
    fitted_pings: u32,
    unfit: Vec<ChannelFinding>,
    start: Vec<f32>,
    quiet: Vec<f32>,
    arrivals: Vec<Arrival>,
    heard: Vec<usize>,
    sorted: Vec<f32>,
    sorted_m: Vec<f64>,
}

impl SensorPath {
    pub(super) fn new(
        plan: &ImagingPlan,
        sensor: &SensorSetup,
        template: &Arc<Template>,
        speed_of_sound_m_s: f64,
    ) -> Self {
        let array = &sensor.array;
        let channel = |index: usize| {
            let place_m = array.positions_m[index];
            let distance_m = (place_m - sensor.emitter_m).norm();
            Channel::new(index, place_m, distance_m, distance_m / speed_of_sound_m_s * plan.sample_rate_hz)
        };
        let channels: Vec<Channel> =
            (0..array.channel_count()).filter(|index| array.enabled[*index]).map(channel).collect();
        let delays = || channels.iter().map(|channel| channel.delay);
        let (least, most) = (delays().fold(f64::INFINITY, f64::min), delays().fold(0.0, f64::max));
        let reach = (REACH_S * plan.sample_rate_hz).ceil();
        let lags = ((least - reach).max(0.0) as i64, (most + reach) as i64);
        let start_len = template.start_len(2 * lags.1.max(0) as usize);
        let batch = if plan.format == SampleFormat::Pdm { PDM_CHANNELS } else { PCM_CHANNELS };
        let quiet_len = channels.iter().map(|channel| channel.quiet_len).max().unwrap_or(0);
        let count = channels.len();
        let stride = count.div_ceil(WITNESSES).max(1);
        Self {
            witnesses: (0..stride).flat_map(|first| (first..count).step_by(stride)).collect(),
            template: Arc::clone(template),
            emitter_m: sensor.emitter_m,
            speed_of_sound_m_s,
            rate_hz: plan.sample_rate_hz,
            batch: batch.min(count),
            next: 0,
            next_search: 0,
            next_flank: 0,
            shift: 0,
            lags,
            map: ChannelMap::Unknown,
            doubts: 0,
            fitted_pings: 0,
            unfit: vec![ChannelFinding::Good; array.channel_count()],
            start: vec![0.0; start_len.min(plan.sample_count.div_ceil(template.stride))],
            quiet: vec![0.0; quiet_len],
            arrivals: Vec::with_capacity(count),
            heard: Vec::with_capacity(count),
            sorted: Vec::with_capacity(count.max(WITNESSES)),
            sorted_m: Vec::with_capacity(count),
            channels,
        }
    }

    pub(super) fn unfit(&self) -> &[ChannelFinding] {
        &self.unfit
    }

    pub(super) fn disregard(&mut self) {
        self.channels.iter_mut().for_each(|channel| (channel.told, channel.late) = (Told::Nothing, None));
        self.unfit.fill(ChannelFinding::Good);
        self.doubts = 0;
        if self.map == ChannelMap::Doubted {
            self.map = ChannelMap::Unknown;
        }
    }

    pub(super) fn calibration(&self) -> Option<Calibration> {
        let pings = f64::from(self.fitted_pings.max(1));
        let heard = self.channels.iter().filter(|channel| matches!(channel.told, Told::InPlace { .. }));
        let heard = heard.map(|channel| (channel.place_m, channel.deviations_m / pings));
        let found = pattern::calibrate(heard, self.emitter_m, self.speed_of_sound_m_s)?;
        let late_s = self.lateness().map_or(0.0, |late| late / self.rate_hz);
        (self.fitted_pings > 0).then_some(Calibration { pings: self.fitted_pings, offset_s: late_s, ..found })
    }

    pub(super) fn listen(&mut self, plan: &ImagingPlan, samples: &Samples) -> DirectFindings {
        self.choose_batch();
        let mut correlation = self.hear_batch(plan, samples);
        if !(correlation >= HEARD_MIN) {
            // Nothing where it should be: is it elsewhere?
            correlation = self.ask_witnesses(plan, samples);
        }
        if correlation >= HEARD_MIN {
            self.search_misplaced(plan, samples, correlation);
            self.judge();
        }
        DirectFindings { correlation, map: self.map }
    }

    /// The channels to be heard in this ping: all until a verdict was reached, then a few in turn.
    fn choose_batch(&mut self) {
        let count = self.channels.len();
        let wanted = if self.map == ChannelMap::Unknown { count } else { self.batch };
        self.heard.clear();
        self.heard.extend((0..wanted).map(|step| (self.next + step) % count));
        self.next = (self.next + wanted) % count.max(1);
    }

    /// Hears the channels of the batch where they should be; returns the median of their coefficients.
    fn hear_batch(&mut self, plan: &ImagingPlan, samples: &Samples) -> f32 {
        self.sorted.clear();
        self.next_flank = (self.next_flank + FLANKED) % self.heard.len().max(1);
        for turn in 0..self.heard.len() {
            let flanked = (turn + self.heard.len() - self.next_flank) % self.heard.len() < FLANKED;
            let channel = &mut self.channels[self.heard[turn]];
            let found = if start::read(plan, samples, channel.index, 0, self.template.stride, &mut self.start) {
                channel.hear(&self.template, &self.start, self.shift, flanked)
            } else {
                Correlation::default()
            };
            channel.coefficient = if is_flat(&self.start) { 0.0 } else { found.coefficient };
            if !(channel.coefficient > 0.0) {
                (channel.told, channel.late) = (Told::Deaf, None);
                continue;
            }
            if channel.quiet_len > 0 {
                let quiet = &mut self.quiet[..channel.quiet_len];
                let read = start::read(plan, samples, channel.index, QUIET_MARGIN, 1, quiet);
                channel.noise = if read { start::power(quiet) } else { 0.0 };
            }
            self.sorted.push(found.coefficient);
        }
        let median = median(&mut self.sorted);
        for &index in &self.heard {
            let channel = &mut self.channels[index];
            if channel.coefficient >= HEARD_MIN && channel.coefficient >= MISPLACED_SHARE * median {
                (channel.told, channel.clarity) = (channel.candidate, channel.coefficient);
            } else if matches!(channel.told, Told::InPlace { .. }) {
                channel.told = Told::Nothing;
            }
        }
        median
    }

    /// Median of the best coefficients of a few channels far apart over all lags. If they agree on where that is, it is where
    /// the others will be heard from now on.
    fn ask_witnesses(&mut self, plan: &ImagingPlan, samples: &Samples) -> f32 {
        let (mut asked, mut coefficients, mut late) = (0, [0.0_f32; WITNESSES], [0_i64; WITNESSES]);
        for witness in 0..self.witnesses.len() {
            if asked == WITNESSES {
                break;
            }
            let channel = &self.channels[self.witnesses[witness]];
            // A dead, stuck or broken channel is found elsewhere; here it just cannot answer.
            if !start::read(plan, samples, channel.index, 0, self.template.stride, &mut self.start)
                || !is_alive(&self.start)
            {
                continue;
            }
            let (lag, found) = self.search(self.lags);
            coefficients[asked] = found.coefficient;
            late[asked] = lag - channel.delay.round() as i64;
            asked += 1;
        }
        late[..asked].sort_unstable();
        coefficients[..asked].sort_by(f32::total_cmp);
        if asked == 0 {
            return 0.0;
        }
        let agreed = late[asked - 1] - late[0] <= self.template.flank;
        if coefficients[asked / 2] >= HEARD_MIN && agreed && late[asked / 2] != self.shift {
            self.shift = late[asked / 2];
            self.channels.iter_mut().for_each(|channel| (channel.told, channel.late) = (Told::Nothing, None));
            self.hear_batch(plan, samples);
        }
        coefficients[asked / 2]
    }

    /// The lag at which the start that was read correlates best.
    fn search(&self, (first, last): (i64, i64)) -> (i64, Correlation) {
        let step = (self.template.flank / SEARCH_STEP_SHARE).max(1);
        let mut best = (first, Correlation::default());
        let mut look = |lag: i64| {
            let found = self.template.correlate(&self.start, lag);
            if found.coefficient > best.1.coefficient {
                best = (lag, found);
            }
            best.0
        };
        let mut around = first;
        (first..=last).step_by(step as usize).for_each(|lag| around = look(lag));
        let (early, late) = (around - step + 1, around + step);
        (early..late).for_each(|lag| around = look(lag));
        best
    }

    /// Looks for some of the channels that are not where they should be, in turn.
    fn search_misplaced(&mut self, plan: &ImagingPlan, samples: &Samples, median: f32) {
        let count = self.channels.len();
        let mut searches = 0;
        for step in 0..count {
            let place = (self.next_search + step) % count;
            let channel = &self.channels[place];
            let lost = match channel.told {
                Told::Nothing | Told::Elsewhere { .. } => self.heard.contains(&place),
                Told::InPlace { .. } => false,
                Told::Deaf => self.heard.contains(&place) && channel.coefficient > 0.0,
            };
            if !lost {
                continue;
            }
            if searches == SEARCHES {
                self.next_search = place;
                return;
            }
            searches += 1;
            if !start::read(plan, samples, channel.index, 0, self.template.stride, &mut self.start) {
                continue;
            }
            let (lag, found) = self.search((self.lags.0 + self.shift.min(0), self.lags.1 + self.shift.max(0)));
            let late = lag as f64 - self.channels[place].delay - self.shift as f64;
            let channel = &mut self.channels[place];
            channel.clarity = found.coefficient;
            if !(found.coefficient >= HEARD_MIN && found.coefficient >= DEAF_SHARE * median) {
                channel.told = Told::Deaf;
            } else if late.abs() <= self.template.flank as f64 {
                channel.hear(&self.template, &self.start, self.shift, false);
                channel.told = channel.candidate;
            } else {
                channel.told = Told::Elsewhere { late };
            }
        }
    }

    /// How late the emission is on all channels, in samples, by the envelope; without what another temperature makes of it.
    fn lateness(&self) -> Option<f64> {
        let mut late = [0.0_f64; 64];
        let mut count = 0;
        for (place, found) in late.iter_mut().zip(self.channels.iter().filter_map(|channel| channel.late)) {
            *place = found;
            count += 1;
        }
        late[..count].sort_unstable_by(f64::total_cmp);
        (count > 0).then(|| late[count / 2] + self.shift as f64)
    }

    /// Judges all channels by what each told last, once each told something.
    fn judge(&mut self) {
        self.sorted.clear();
        let hears = |channel: &&Channel| matches!(channel.told, Told::InPlace { .. } | Told::Elsewhere { .. });
        self.sorted.extend(self.channels.iter().filter(hears).map(|channel| channel.clarity));
        let clear = median(&mut self.sorted) >= CLEAR_MIN;
        let pending = self.channels.iter().filter(|channel| channel.told == Told::Nothing).count();
        self.mark_unfit();
        if clear && pending > PENDING_MAX && self.map == ChannelMap::Fits {
            // So many that are not where they were: until it is known where they are, nothing is.
            self.map = ChannelMap::Doubted;
        }
        if !clear || pending > 0 {
            return;
        }
        let fits = self.map_fits();
        self.doubts = if fits { 0 } else { self.doubts.saturating_add(1) };
        let round = self.channels.len().div_ceil(self.batch.max(1)) as u32;
        self.map = match self.map {
            _ if fits => ChannelMap::Fits,
            ChannelMap::Wrong => ChannelMap::Wrong,
            _ if self.doubts >= CERTAIN_ROUNDS * round => ChannelMap::Wrong,
            _ => ChannelMap::Doubted,
        };
    }

    /// Whether all channels but one that hear anything are where they should be, and all in time.
    fn map_fits(&mut self) -> bool {
        let metres = self.speed_of_sound_m_s / self.rate_hz;
        let phasors = self.channels.iter().filter_map(|channel| match channel.told {
            Told::InPlace { phasor, .. } => Some(phasor),
            _ => None,
        });
        let shared = f64::from(phasors.sum::<Complex<f32>>().arg());
        self.arrivals.clear();
        for channel in &self.channels {
            let late = match channel.told {
                Told::InPlace { phasor, .. } => -turned(f64::from(phasor.arg()) - shared) / self.template.mean_rad,
                Told::Elsewhere { late } => late,
                Told::Nothing | Told::Deaf => continue,
            };
            let (distance_m, deviation_m) = (channel.distance_m, late * metres);
            self.arrivals.push(Arrival { distance_m, deviation_m, outlier: false });
        }
        let fit = pattern::fit(&mut self.arrivals, &mut self.sorted_m);
        let heard = self.channels.iter_mut().filter(|channel| !matches!(channel.told, Told::Nothing | Told::Deaf));
        let (mut distances_m, mut count) = (0.0, 0.0);
        for (channel, arrival) in heard.zip(&self.arrivals) {
            if arrival.outlier {
                self.unfit[channel.index] = ChannelFinding::Misplaced;
            }
            distances_m += channel.distance_m;
            count += 1.0;
        }
        // Another temperature makes all of them late too.
        let expected = fit.scale * distances_m / f64::max(count, 1.0) / metres;
        let late_max = LATE_SHARE * self.template.rate_shift;
        let in_time = self.lateness().is_none_or(|late| (late - expected).abs() <= late_max);
        let holds = fit.holds() && in_time;
        if holds {
            self.fitted_pings = self.fitted_pings.saturating_add(1);
            let heard = self.channels.iter_mut().filter(|channel| !matches!(channel.told, Told::Nothing | Told::Deaf));
            heard.zip(&self.arrivals).for_each(|(channel, arrival)| channel.deviations_m += arrival.deviation_m);
        }
        holds
    }

    /// Marks what is unfit for an image by its strength and its noise.
    fn mark_unfit(&mut self) {
        self.sorted.clear();
        self.sorted.extend(self.channels.iter().filter_map(|channel| match channel.told {
            Told::InPlace { strength, .. } => Some(strength),
            _ => None,
        }));
        let usual = median(&mut self.sorted);
        self.sorted.clear();
        self.sorted.extend(self.channels.iter().filter(|c| c.quiet_len > 0 && c.told != Told::Deaf).map(|c| c.noise));
        self.sorted.sort_unstable_by(f32::total_cmp);
        // Of the quieter half, so that half of the channels may be broken.
        let quiet = self.sorted.get(self.sorted.len() / 4).copied().unwrap_or(0.0);
        for channel in &self.channels {
            let strange = match channel.told {
                Told::InPlace { strength, .. } => !STRENGTH.contains(&(strength / usual)),
                Told::Deaf => true,
                Told::Nothing | Told::Elsewhere { .. } => false,
            };
            let noisy = !(channel.noise <= NOISE_FLOOR.max(NOISY * quiet));
            self.unfit[channel.index] = if strange {
                ChannelFinding::Deaf
            } else if noisy {
                ChannelFinding::Noisy
            } else {
                ChannelFinding::Good
            };
        }
    }
}

/// An angle within half a turn.
fn turned(angle_rad: f64) -> f64 {
    angle_rad - 2.0 * PI * (angle_rad / (2.0 * PI)).round()
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
