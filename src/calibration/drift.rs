//! Watches, while the robot works, whether air and sensors are still what they were calibrated or configured as.
//!
//! In: the raw pings after their command is out, of each sensor a few channels. Out: estimates and [`Alarms`] a sensor. What it
//! compares with is the calibration, or, without one, what it heard in its first minute: then only changes since the start show, and a
//! wrong speed of sound only when it is wrong by more than the array's tolerances can hide. An alarm needs a change beyond its
//! tolerance, beyond what chance explains, twice in a row; it ends below four fifths of it. Stops nothing, changes nothing,
//! allocates nothing after it was made.

use super::arrival::Sweep;
use super::file::SensorCalibration;
use super::measure::{DECIBELS, Tolerances};
use super::observe::{Level, Observer};
use super::params::{Applied, CalibrationParams};
use super::running::BLOCK;
use super::solve::{Heard, Known, Solution, Way, solve};
use crate::imaging::plan::ImagingPlan;
use crate::sensor::{SensorSetup, air, per_emission};
use crate::signal::{PingSet, SampleFormat};
use nalgebra::Vector3;
use std::fmt;
use std::sync::Arc;

/// Channels heard in a ping: one of PCM takes 5 us, one of PDM must be demodulated and takes 30.
const PCM_CHANNELS: usize = 4;
const PDM_CHANNELS: usize = 1;
/// Blocks of values that an estimate remembers, and those that a start without a calibration learns from.
const MEMORY_BLOCKS: f64 = 4.0;
const LEARNING_BLOCKS: u32 = 2;
/// What may change, before anything is known of it: the air by 18 degrees, a trigger by 0.2 us, an emitter by 0.3 mm, a microphone by
/// 0.02 mm (standard deviations). What changes by more stands out from the others.
const CHANGE: Tolerances = Tolerances { speed_m_s: 10.0, late_s: 0.2e-6, emitter_m: 0.3e-3, place_m: 0.02e-3 };
/// A change counts when it is this many of its standard deviations.
const SURE_SPREADS: f64 = 4.0;
/// An alarm ends below this share of its tolerance.
const END_SHARE: f64 = 0.8;
/// Looks in a row that begin and end an alarm.
const LOOKS: u8 = 2;
/// A gain that was known worse than this says nothing of a change.
const GAIN_SD_MAX_DB: f64 = 0.5;

/// Kinds of alarms.
const KINDS: usize = 5;

/// What has drifted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Alarms(u32);

impl Alarms {
    /// The speed of sound is another one than images are made with.
    pub const SPEED: Self = Self(1);
    /// The way to a microphone has changed.
    pub const PATH: Self = Self(2);
    /// A microphone's gain has changed.
    pub const GAIN: Self = Self(4);
    /// The emitter has become weaker.
    pub const LEVEL: Self = Self(8);
    /// The emitter has moved.
    pub const EMITTER: Self = Self(16);
    const ALL: [(Self, &'static str); KINDS] = [
        (Self::SPEED, "speed of sound"),
        (Self::PATH, "microphone moved"),
        (Self::GAIN, "microphone gain"),
        (Self::LEVEL, "emitter weaker"),
        (Self::EMITTER, "emitter moved"),
    ];

    /// The bits, as they are on the wire: 1 speed of sound, 2 microphone moved, 4 microphone gain, 8 emitter weaker, 16 emitter moved.
    #[must_use]
    pub fn bits(self) -> u32 {
        self.0
    }

    /// From the bits on the wire.
    #[must_use]
    pub fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Whether all of `other` are among these.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl fmt::Display for Alarms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut names = Self::ALL.iter().filter(|(alarm, _)| self.contains(*alarm)).map(|(_, name)| *name);
        f.write_str(names.next().unwrap_or("none"))?;
        names.try_for_each(|name| write!(f, ", {name}"))
    }
}

/// What is known of one sensor now.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drift {
    /// What has drifted.
    pub alarms: Alarms,
    /// Speed of sound; 0 while nothing is known.
    pub speed_of_sound_m_s: f64,
    /// Standard deviation of its change since the calibration or the start.
    pub speed_sd_m_s: f64,
    /// By how much it differs from what images are made with, as far as it can be told.
    pub speed_off_m_s: f64,
    /// Microphone whose way changed most, and by how much.
    pub path: (usize, f64),
    /// Microphone whose gain changed most, decibels.
    pub gain: (usize, f64),
    /// Change of the emitter's level, decibels.
    pub level_db: f64,
    /// By how much the emitter has moved, as far as that can be told.
    pub emitter_m: f64,
    /// Looks taken.
    pub looks: u64,
}

impl Drift {
    /// Temperature of the air; NaN while nothing is known.
    #[must_use]
    pub fn air_temperature_c(&self) -> f64 {
        if self.looks == 0 { f64::NAN } else { air::air_temperature_c(self.speed_of_sound_m_s) }
    }
}

impl fmt::Display for Drift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "sound at {:.1} m/s, air at {:.1} C; microphone {} {:+.2} mm, microphone {} {:+.1} dB, emitter {:+.1} dB, {:.2} mm",
            self.speed_of_sound_m_s,
            self.air_temperature_c(),
            self.path.0,
            1e3 * self.path.1,
            self.gain.0,
            self.gain.1,
            self.level_db,
            1e3 * self.emitter_m
        )
    }
}

/// What is compared with.
#[derive(Debug, Clone)]
struct Baseline {
    speed_m_s: f64,
    /// Of the speed itself, not of its change.
    speed_sd_m_s: f64,
    late_s: f64,
    /// What was used for images when it was taken.
    used_m_s: f64,
    /// One entry a channel in use.
    longer_m: Vec<f64>,
    level: Vec<Option<f64>>,
}

#[derive(Debug, Clone)]
struct SensorDrift {
    observer: Observer,
    sensor: SensorSetup,
    baseline: Option<Baseline>,
    /// Where a start without a calibration puts it: made beforehand.
    blank: Option<Baseline>,
    used_m_s: f64,
    seen_arrivals: u64,
    /// Blocks that were heard.
    learned: u32,
    /// Looks in a row that said so, a counter an alarm.
    counts: [u8; KINDS],
    now: Drift,
}

/// Watches all sensors.
#[derive(Debug, Clone)]
pub struct DriftMonitor {
    params: CalibrationParams,
    sensors: Vec<SensorDrift>,
    heard: Vec<Heard>,
    levels: Vec<Level>,
    ways: Vec<Way>,
}

impl DriftMonitor {
    /// Prepares for the sensors of a plan, as the configuration has them before any calibration is applied; `used_m_s` is the speed
    /// of sound that images are made with.
    #[must_use]
    pub fn new(plan: &ImagingPlan, nominal: &[SensorSetup], params: &CalibrationParams, used_m_s: f64) -> Self {
        let watched = if params.watch { nominal } else { &[] };
        let sweeps = per_emission(watched, |index| Sweep::new(&watched[index].emission));
        let sensors: Vec<SensorDrift> = watched
            .iter()
            .zip(sweeps)
            .map(|(sensor, sweep)| {
                let measured = params.measured.as_ref().and_then(|file| file.sensor(&sensor.name));
                let applied = params.apply.contains(&Applied::SpeedOfSound);
                SensorDrift::new(plan, sensor, &sweep, measured.map(|found| (found, applied)), used_m_s)
            })
            .collect();
        let most = nominal.iter().map(|sensor| sensor.array.channel_count()).max().unwrap_or(0);
        let (heard, levels, ways) = (Vec::with_capacity(most), Vec::with_capacity(most), Vec::with_capacity(most));
        Self { params: params.clone(), sensors, heard, levels, ways }
    }

    /// Listens to some channels of each ping of a set.
    pub fn listen(&mut self, plan: &ImagingPlan, pings: &PingSet) {
        for ping in pings.iter_present() {
            let Some(sensor) = self.sensors.get_mut(ping.sensor_index) else { continue };
            sensor.observer.listen(plan, &ping.samples);
            // A block of every channel, on average.
            let arrivals = sensor.observer.arrivals() - sensor.seen_arrivals;
            if arrivals >= (BLOCK * sensor.observer.indices().count()) as u64 {
                sensor.seen_arrivals += arrivals;
                sensor.learned = sensor.learned.saturating_add(1);
                sensor.look(&self.params, &mut self.heard, &mut self.levels, &mut self.ways);
            }
        }
    }

    /// What is known of a sensor now.
    #[must_use]
    pub fn drift(&self, sensor_index: usize) -> Drift {
        self.sensors.get(sensor_index).map_or_else(Drift::default, |sensor| sensor.now)
    }
}

impl SensorDrift {
    fn new(
        plan: &ImagingPlan,
        nominal: &SensorSetup,
        sweep: &Arc<Sweep>,
        measured: Option<(&SensorCalibration, bool)>,
        used_m_s: f64,
    ) -> Self {
        let batch = if plan.format == SampleFormat::Pdm { PDM_CHANNELS } else { PCM_CHANNELS };
        let sensor = measured.map_or_else(|| nominal.clone(), |(found, _)| found.reference(nominal));
        let reference_m_s = measured.map_or(used_m_s, |(found, _)| found.speed_of_sound_m_s);
        let phase_rad = measured.map(|(found, _)| found.phase_rad);
        let observer = Observer::new(plan, &sensor, sweep, reference_m_s, (batch, MEMORY_BLOCKS), phase_rad);
        let count = observer.indices().count();
        let blank = measured.is_none().then(|| Baseline {
            speed_m_s: used_m_s,
            speed_sd_m_s: 0.0,
            late_s: 0.0,
            used_m_s,
            longer_m: vec![0.0; count],
            level: vec![None; count],
        });
        let baseline = measured.map(|(found, applied)| Baseline {
            speed_m_s: found.speed_of_sound_m_s,
            speed_sd_m_s: found.speed_of_sound_sd_m_s,
            late_s: 1e-6 * found.late_us,
            used_m_s: if applied { found.speed_of_sound_m_s } else { found.configured_m_s },
            longer_m: vec![0.0; count],
            level: observer.indices().map(|index| level_of(found, index)).collect(),
        });
        let now = Drift::default();
        Self { observer, sensor, baseline, blank, used_m_s, seen_arrivals: 0, learned: 0, counts: [0; KINDS], now }
    }

    /// Estimates anew and judges what changed.
    fn look(
        &mut self,
        params: &CalibrationParams,
        heard: &mut Vec<Heard>,
        levels: &mut Vec<Level>,
        ways: &mut Vec<Way>,
    ) {
        self.observer.heard(heard);
        self.observer.levels(levels);
        if self.baseline.is_none() {
            self.learn(heard, levels, ways);
            return;
        }
        let Some(baseline) = &self.baseline else { return };
        let reference_m_s = self.observer.reference_m_s();
        for (one, longer_m) in heard.iter_mut().zip(&baseline.longer_m) {
            one.way_m -= longer_m + baseline.late_s * reference_m_s;
        }
        let known = known(reference_m_s, &self.sensor, &CHANGE);
        let Some(found) = solve(heard, &known, ways) else { return };
        let now = describe(&found, baseline, ways, levels, &self.observer, (self.sensor.emitter_m, self.used_m_s));
        self.judge(params, &found, now, ways, levels);
    }

    /// Takes what was heard so far as what everything later is compared with.
    fn learn(&mut self, heard: &[Heard], levels: &[Level], ways: &mut Vec<Way>) {
        let known = known(self.observer.reference_m_s(), &self.sensor, &Tolerances::default());
        let Some(found) = solve(heard, &known, ways) else { return };
        if self.learned < LEARNING_BLOCKS {
            return;
        }
        let Some(mut baseline) = self.blank.take() else { return };
        (baseline.speed_m_s, baseline.speed_sd_m_s) = (found.speed_of_sound_m_s, found.speed_sd_m_s);
        let stretch = self.observer.reference_m_s() / found.speed_of_sound_m_s;
        for (longer_m, one) in baseline.longer_m.iter_mut().zip(heard) {
            // Everything that the reference does not explain at the configured speed, lateness included.
            *longer_m = one.way_m - stretch * (one.place_m - self.sensor.emitter_m).norm();
        }
        for (kept, level) in baseline.level.iter_mut().zip(levels) {
            *kept = level.good.then_some(level.ln);
        }
        self.baseline = Some(baseline);
    }

    fn judge(&mut self, params: &CalibrationParams, found: &Solution, mut now: Drift, ways: &[Way], levels: &[Level]) {
        let Some(baseline) = &self.baseline else { return };
        let tolerance_m_s = params.speed_tolerance * self.used_m_s;
        let changed_m_s = now.speed_off_m_s;
        // What is wrong from the first shows only where it is more than the calibration itself may be wrong.
        let wrong_m_s = found.speed_of_sound_m_s - self.used_m_s;
        let total_sd_m_s = found.speed_sd_m_s.hypot(baseline.speed_sd_m_s);
        let sure = |value: f64, sd: f64| value.abs() > SURE_SPREADS * sd;
        let speed = |share: f64| {
            (changed_m_s.abs() > share * tolerance_m_s && sure(changed_m_s, found.speed_sd_m_s))
                || (wrong_m_s.abs() > share * tolerance_m_s && sure(wrong_m_s, total_sd_m_s))
        };
        let (path_sd_m, gain_sd_db) =
            (spread_of(ways, now.path.0, &self.observer), spread_db(levels, now.gain.0, &self.observer));
        let path = |share: f64| now.path.1.abs() > share * params.path_tolerance_m && sure(now.path.1, path_sd_m);
        let gain = |share: f64| now.gain.1.abs() > share * params.gain_tolerance_db && sure(now.gain.1, gain_sd_db);
        let level = |share: f64| -now.level_db > share * params.level_tolerance_db;
        let emitter_sd_m = found.emitter_sd_m.norm_squared() - found.emitter_sd_m.x.powi(2);
        let emitter = |share: f64| {
            now.emitter_m > share * params.path_tolerance_m && sure(now.emitter_m, emitter_sd_m.max(0.0).sqrt())
        };
        let told: [&dyn Fn(f64) -> bool; KINDS] = [&speed, &path, &gain, &level, &emitter];
        let mut alarms = self.now.alarms.0;
        for ((told, count), (alarm, _)) in told.iter().zip(&mut self.counts).zip(Alarms::ALL) {
            let on = alarms & alarm.0 != 0;
            let differs = if on { !told(END_SHARE) } else { told(1.0) };
            *count = if differs { *count + 1 } else { 0 };
            if *count >= LOOKS {
                alarms ^= alarm.0;
                *count = 0;
            }
        }
        now.alarms = Alarms(alarms);
        now.looks = self.now.looks + 1;
        self.now = now;
    }
}

/// Level that a calibration says a channel has, if it knows well enough.
fn level_of(found: &SensorCalibration, index: usize) -> Option<f64> {
    let known = found.gain_sd_db.get(index).is_some_and(|sd_db| *sd_db <= GAIN_SD_MAX_DB);
    found.gain_db.get(index).filter(|_| known).map(|gain_db| (found.level_db + gain_db) / DECIBELS)
}

fn known(reference_m_s: f64, sensor: &SensorSetup, tolerances: &Tolerances) -> Known {
    Known {
        speed_of_sound_m_s: reference_m_s,
        speed_sd_m_s: tolerances.speed_m_s,
        late_sd_s: tolerances.late_s,
        emitter_m: sensor.emitter_m,
        emitter_sd_m: tolerances.emitter_m,
        place_sd_m: tolerances.place_m,
    }
}

fn describe(
    found: &Solution,
    baseline: &Baseline,
    ways: &[Way],
    levels: &[Level],
    observer: &Observer,
    (emitter_m, used_m_s): (Vector3<f64>, f64),
) -> Drift {
    // A change of the world that the configuration has followed is none.
    let changed_m_s = found.speed_of_sound_m_s - baseline.speed_m_s - (used_m_s - baseline.used_m_s);
    let mut now = Drift {
        speed_of_sound_m_s: found.speed_of_sound_m_s,
        speed_sd_m_s: found.speed_sd_m_s,
        speed_off_m_s: changed_m_s,
        level_db: median_change_db(levels, baseline),
        emitter_m: (found.emitter_m - emitter_m).norm(),
        ..Drift::default()
    };
    for (((index, way), level), was) in observer.indices().zip(ways).zip(levels).zip(&baseline.level) {
        // A microphone that is not heard has no way; that it is deaf is told elsewhere.
        if way.longer_m.abs() > now.path.1.abs() {
            now.path = (index, way.longer_m);
        }
        let Some(was) = was.filter(|_| level.good) else { continue };
        let change_db = DECIBELS * (level.ln - was) - now.level_db;
        if change_db.abs() > now.gain.1.abs() {
            now.gain = (index, change_db);
        }
    }
    now
}

/// Median change of the levels of all channels; of those that are compared, the middle one by counting.
fn median_change_db(levels: &[Level], baseline: &Baseline) -> f64 {
    let changes = || {
        let pairs = levels.iter().zip(&baseline.level).filter(|(level, _)| level.good);
        pairs.filter_map(|(level, was)| was.map(|was| level.ln - was))
    };
    let count = changes().count();
    let below = |value: f64| changes().filter(|other| *other < value).count();
    let middle = changes().find(|value| {
        let below = below(*value);
        let same = changes().filter(|other| other == value).count();
        (below..below + same).contains(&(count / 2))
    });
    DECIBELS * middle.unwrap_or(0.0)
}

fn spread_of(ways: &[Way], index: usize, observer: &Observer) -> f64 {
    observer.indices().zip(ways).find(|(found, _)| *found == index).map_or(f64::INFINITY, |(_, way)| way.sd_m)
}

fn spread_db(levels: &[Level], index: usize, observer: &Observer) -> f64 {
    let found = observer.indices().zip(levels).find(|(found, _)| *found == index);
    found.map_or(f64::INFINITY, |(_, level)| DECIBELS * level.sd)
}
