//! From what an observer heard to a sensor's calibration.
//!
//! In: an [`Observer`], the sensor as configured, how well it is known. Out: a [`SensorCalibration`]. Says which unknowns the data told
//! nothing of. Hears nothing itself and writes nothing.

use super::file::{SensorCalibration, geometry_of};
use super::observe::{CLIPPED_MAX, Observer};
use super::solve::{Known, Solution, solve};
use crate::sensor::{SensorSetup, air};
use nalgebra::Vector3;

/// How well a sensor is known before it is measured: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerances {
    /// Of the speed of sound.
    pub speed_m_s: f64,
    /// Of the beginning of the emission.
    pub late_s: f64,
    /// Of each coordinate of the emitter.
    pub emitter_m: f64,
    /// Of a microphone's place along the line from the emitter.
    pub place_m: f64,
}

impl Default for Tolerances {
    /// The air 18 degrees off, a trigger of 3 us, an emitter glued on by hand, microphones placed by machine: a real array was found
    /// to fit to 0.6 mm rms.
    fn default() -> Self {
        Self { speed_m_s: 10.0, late_s: 3e-6, emitter_m: 2e-3, place_m: 0.5e-3 }
    }
}

/// Decibels of a natural logarithm of amplitudes.
pub(super) const DECIBELS: f64 = 20.0 / std::f64::consts::LN_10;
/// A standard deviation that is at least this share of what was known before says that nothing was learned.
const LEARNED_SHARE: f64 = 0.7;

/// The calibration that fits what `observer` heard of `sensor` best; `speed_m_s` is what the speed of sound is thought to be. `None`
/// where too few microphones were heard.
#[must_use]
pub fn measure(
    observer: &Observer,
    sensor: &SensorSetup,
    speed_m_s: f64,
    tolerances: &Tolerances,
) -> Option<SensorCalibration> {
    let known = Known {
        speed_of_sound_m_s: speed_m_s,
        speed_sd_m_s: tolerances.speed_m_s,
        late_sd_s: tolerances.late_s,
        emitter_m: sensor.emitter_m,
        emitter_sd_m: tolerances.emitter_m,
        place_sd_m: tolerances.place_m,
    };
    let (mut heard, mut levels, mut ways) = (Vec::new(), Vec::new(), Vec::new());
    observer.heard(&mut heard);
    // The thermometer may know another speed than the one configured.
    heard.iter_mut().for_each(|one| {
        one.way_m *= speed_m_s / observer.reference_m_s();
        one.sd_m *= speed_m_s / observer.reference_m_s();
    });
    observer.levels(&mut levels);
    let found = solve(&heard, &known, &mut ways)?;
    // The level is told with the distance by the configuration; the sound has come from where the emitter really is.
    for ((one, way), level) in heard.iter().zip(&ways).zip(&mut levels) {
        let distance_m = |emitter_m: Vector3<f64>| (one.place_m - emitter_m).norm().max(1e-6);
        let farther_m = distance_m(found.emitter_m) + way.longer_m;
        level.ln += (farther_m.max(1e-6) / distance_m(sensor.emitter_m)).ln();
    }
    let mut made = of_sensor(observer, sensor, &found, &known)?;
    let mut sorted: Vec<f64> = levels.iter().filter(|level| level.good).map(|level| level.ln).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied();
    // TOML has no number for silence that people like to read.
    made.level_db = DECIBELS * usual.unwrap_or(0.0);
    for (((index, way), heard), level) in observer.indices().zip(&ways).zip(&heard).zip(&levels) {
        (made.path_m[index], made.path_sd_m[index]) = (way.longer_m, way.sd_m);
        if heard.unheard {
            made.unheard.push(index);
            continue;
        }
        if way.outlier {
            made.misplaced.push(index);
        }
        if level.clipped > CLIPPED_MAX {
            made.clipped.push(index);
        }
        if let Some(usual) = usual.filter(|_| level.good) {
            (made.gain_db[index], made.gain_sd_db[index]) = (DECIBELS * (level.ln - usual), DECIBELS * level.sd);
        }
    }
    round(&mut made);
    Some(made)
}

/// To what a person can read and nobody can measure: a hundredth of a micrometre, ten-thousandths of the rest.
fn round(made: &mut SensorCalibration) {
    let to = |steps: f64| move |value: &mut f64| *value = (*value * steps).round() / steps;
    let lengths = made.path_m.iter_mut().chain(&mut made.path_sd_m).chain(&mut made.emitter_m);
    lengths.chain(&mut made.emitter_sd_m).chain([&mut made.residual_m]).for_each(to(1e8));
    made.gain_db.iter_mut().chain(&mut made.gain_sd_db).for_each(to(1e4));
    [
        &mut made.speed_of_sound_m_s,
        &mut made.speed_of_sound_sd_m_s,
        &mut made.air_temperature_c,
        &mut made.air_temperature_sd_c,
        &mut made.late_us,
        &mut made.late_sd_us,
        &mut made.level_db,
        &mut made.phase_rad,
    ]
    .into_iter()
    .for_each(to(1e4));
}

/// What concerns the sensor as a whole; microphones as configured.
fn of_sensor(observer: &Observer, sensor: &SensorSetup, found: &Solution, known: &Known) -> Option<SensorCalibration> {
    let count = sensor.array.channel_count();
    let kelvins = air::kelvins_per_m_s(found.speed_of_sound_m_s);
    Some(SensorCalibration {
        name: sensor.name.clone(),
        microphones: count,
        geometry: geometry_of(sensor),
        pings: observer.pings(),
        configured_m_s: observer.reference_m_s(),
        speed_of_sound_m_s: found.speed_of_sound_m_s,
        speed_of_sound_sd_m_s: found.speed_sd_m_s,
        air_temperature_c: air::air_temperature_c(found.speed_of_sound_m_s),
        air_temperature_sd_c: kelvins * found.speed_sd_m_s,
        late_us: 1e6 * found.late_s,
        late_sd_us: 1e6 * found.late_sd_s,
        phase_rad: observer.shared_rad()?,
        emitter_m: found.emitter_m.into(),
        emitter_sd_m: found.emitter_sd_m.into(),
        residual_m: found.residual_m,
        level_db: 0.0,
        directions_told: found.told,
        not_observable: not_observable(found, known),
        unheard: Vec::new(),
        misplaced: Vec::new(),
        clipped: Vec::new(),
        path_m: vec![0.0; count],
        path_sd_m: vec![known.place_sd_m; count],
        gain_db: vec![0.0; count],
        gain_sd_db: vec![GAIN_UNKNOWN_DB; count],
    })
}

/// What is said of a gain that was not measured: MEMS microphones differ by 1 dB.
const GAIN_UNKNOWN_DB: f64 = 1.0;

/// Names of the unknowns that the data told nothing of that was not known.
fn not_observable(found: &Solution, known: &Known) -> Vec<String> {
    let sd_m = found.emitter_sd_m;
    let pairs = [
        ("speed of sound", found.speed_sd_m_s, known.speed_sd_m_s),
        ("lateness", found.late_sd_s, known.late_sd_s),
        ("emitter x", sd_m.x, known.emitter_sd_m),
        ("emitter y", sd_m.y, known.emitter_sd_m),
        ("emitter z", sd_m.z, known.emitter_sd_m),
    ];
    let blind = pairs.iter().filter(|(_, now, before)| !(*now < LEARNED_SHARE * before));
    blind.map(|(name, _, _)| (*name).to_owned()).collect()
}
