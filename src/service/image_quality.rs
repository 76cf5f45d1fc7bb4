//! What each beamformer makes of the same scenes: sharpness, side lobes, dynamic range, time.
//!
//! In: a configuration, of which the first sensor, format and grid are taken. Out: a [`Quality`] a beamformer and its image of a fixed
//! scene. The scenes are pings of single thin pillars by the simulator, brought to one amplitude and added up with white noise, so
//! that what is asked is known exactly. Judges no place and changes no configuration.

use super::wiring::{self, SensingSetup};
use super::{ServiceError, simulator};
use crate::config::Config;
use crate::imaging::params::{Apodization, Beamformer, Coherence, ImagingParams, Prefer};
use crate::imaging::{Imager, ImagerOptions};
use crate::sensor::SensorParams;
use crate::signal::{Energyscape, MaskTable, PingSet, SampleFormat, Samples};
use crate::sim::{Pillar, SimParams, World};
use crate::time::Stamp;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::sync::Arc;
use std::time::Instant;

/// Range of the loud echo, and of the one behind it.
const RANGE_M: f64 = 1.5;
const BEHIND_M: f64 = 1.8;
/// Farther is nothing to see; the time is that of these ranges.
const FARTHEST_M: f64 = 2.5;
/// Amplitude of the loud echo, and of the noise of each microphone, full scale 1: 26 dB in a sample, 70 dB in the image.
const LOUD: f64 = 0.02;
const NOISE_RMS: f64 = 1e-3;
/// Bearings of the loud and of the weak echo.
const PLACES_DEG: [[f64; 2]; 3] = [[-10.0, 35.0], [40.0, -15.0], [0.0, 60.0]];
/// The loud echo's main lobe for the search of the weak one, to either side: at its bearings the sweep's own side lobes in range
/// stand, which no beamformer changes.
const MAIN_LOBE_DEG: f64 = 16.0;
/// A peak so near to the weak echo is the weak echo.
const SAME_DEG: f64 = 5.0;
const SAME_M: f64 = 0.03;
/// Weak echoes are tried down to this, in steps.
const WEAKEST_DB: i32 = -60;
const STEP_DB: i32 = 3;
/// Runs of which the median time counts.
const TIMED: usize = 9;

/// A beamformer under a name.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// For tables and pictures.
    pub name: &'static str,
    /// How it images; the rest is the configuration's.
    pub beamformer: Beamformer,
    /// Order of products.
    pub multiply_order: Option<usize>,
    /// Factor on the amplitude.
    pub coherence: Coherence,
    /// Weights of the microphones.
    pub apodization: Apodization,
    /// As in the configuration.
    pub focus_to_m: Option<f64>,
    /// Rounds of CLEAN.
    pub clean_rounds: Option<usize>,
}

/// What was found of one beamformer; all levels are in decibels against the loud echo.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Name of the beamformer.
    pub name: &'static str,
    /// What the loud echo reads between two bearings of the grid.
    pub loud_db: f64,
    /// Width of the main lobe at half its amplitude, on boresight.
    pub width_deg: f64,
    /// Highest side lobe in bearing, mean of the scenes.
    pub side_lobe_db: f64,
    /// Root mean square of the image where there is nothing but noise.
    pub noise_db: f64,
    /// Weakest second echo at the same range that is still the second-highest peak of the image in every scene.
    pub beside_db: f64,
    /// The same 0.3 m behind.
    pub behind_db: f64,
    /// Median time of one sensor's image.
    pub time_ms: f64,
    /// The first scene with a second echo of -15 dB beside the first and a third of -25 dB behind the second.
    pub image: Energyscape,
}

/// All that are compared, the plain one first.
#[must_use]
pub fn candidates() -> Vec<Candidate> {
    use Beamformer::{DelayAndSum, DelayMultiplyAndSum, MinimumVariance};
    let plain = Candidate {
        name: "delay-and-sum, plane waves",
        beamformer: DelayAndSum,
        multiply_order: None,
        coherence: Coherence::None,
        apodization: Apodization::Uniform,
        focus_to_m: Some(0.0),
        clean_rounds: None,
    };
    let focused = Candidate { name: "delay-and-sum, focused", focus_to_m: None, ..plain.clone() };
    let with = |name, coherence| Candidate { name, coherence, ..focused.clone() };
    let multiplied = |name, order, coherence| Candidate {
        name,
        beamformer: DelayMultiplyAndSum,
        multiply_order: Some(order),
        coherence,
        ..focused.clone()
    };
    vec![
        plain,
        focused.clone(),
        Candidate { name: "low-side-lobe weights", apodization: Apodization::LowSideLobes, ..focused.clone() },
        with("amplitude coherence", Coherence::Amplitude),
        with("phase coherence", Coherence::Phase),
        with("sign coherence", Coherence::Sign),
        multiplied("multiply 2", 2, Coherence::None),
        multiplied("multiply 3", 3, Coherence::None),
        multiplied("multiply 4", 4, Coherence::None),
        multiplied("multiply 5", 5, Coherence::None),
        multiplied("multiply 2, amplitude coherence", 2, Coherence::Amplitude),
        multiplied("multiply 5, amplitude coherence", 5, Coherence::Amplitude),
        Candidate {
            name: "weights, amplitude coherence",
            apodization: Apodization::LowSideLobes,
            coherence: Coherence::Amplitude,
            ..focused.clone()
        },
        Candidate { name: "CLEAN, 2 rounds", clean_rounds: Some(2), ..focused.clone() },
        Candidate { name: "CLEAN, 4 rounds", clean_rounds: Some(4), ..focused.clone() },
        Candidate { name: "minimum variance", beamformer: MinimumVariance, ..focused },
    ]
}

/// Pings of the scenes' single echoes.
pub struct Scenes {
    config: Config,
    /// `[scene][loud, beside, behind]`: `[channel][sample]`, each of amplitude 1 in the plain image.
    echoes: Vec<[Vec<f32>; 3]>,
    /// On boresight.
    ahead: Vec<f32>,
    noise: Vec<f32>,
    blank: PingSet,
}

impl Scenes {
    /// Lets the simulator make them.
    ///
    /// # Errors
    /// When the configuration cannot be planned for or simulated.
    pub fn new(config: &Config) -> Result<Self, ServiceError> {
        let mut config = config.clone();
        config.recording.format = SampleFormat::PcmF32;
        config.recording.sample_rate_hz = None;
        config.recording.samples = None;
        config.recording.decimation = None;
        // One sensor in the middle of nothing.
        let first = config.sensor.first().cloned().unwrap_or_else(|| SensorParams::ertis("front", 0.0, 0.0, 0.0));
        config.sensor = vec![SensorParams { mount: crate::sensor::MountParams::default(), ..first }];
        config.obstruction.clear();
        config.imaging.range_max_m = config.imaging.range_max_m.min(FARTHEST_M);
        let plain = candidates().swap_remove(0);
        let setup = setup_of(&config, &plain)?;
        let mut imager = imager(&setup, Prefer::Cpu)?;
        let mut blank = None;
        let mut echo = |bearing_deg: f64, range_m: f64| -> Result<Vec<f32>, ServiceError> {
            let mut pings = single_echo(&config, &setup, bearing_deg, range_m)?;
            let loudest = f64::from(imager.image(&pings)?.energyscapes[0].peak().1);
            let values = samples(&mut pings).iter().map(|value| (f64::from(*value) / loudest) as f32).collect();
            blank = Some(pings);
            Ok(values)
        };
        let mut echoes = Vec::new();
        for [loud_deg, weak_deg] in PLACES_DEG {
            echoes.push([echo(loud_deg, RANGE_M)?, echo(weak_deg, RANGE_M)?, echo(weak_deg, BEHIND_M)?]);
        }
        let ahead = echo(0.0, RANGE_M)?;
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(0.0, NOISE_RMS as f32).map_err(|error| ServiceError::Internal(error.to_string()))?;
        let noise = ahead.iter().map(|_| normal.sample(&mut random)).collect();
        let blank = blank.ok_or_else(|| ServiceError::Internal("no scene".to_owned()))?;
        Ok(Self { config, echoes, ahead, noise, blank })
    }

    /// Images all scenes with one beamformer.
    ///
    /// # Errors
    /// When it cannot be planned for or the backend fails.
    pub fn judge(&self, candidate: &Candidate, prefer: Prefer) -> Result<Quality, ServiceError> {
        let setup = setup_of(&self.config, candidate)?;
        let mut imager = imager(&setup, prefer)?;
        let image = self.image(&mut imager, &[(&self.ahead, 1.0)], 0.0)?;
        let width_deg = width_deg(&image);
        let scenes = &self.echoes;
        let mut side_lobe_db = 0.0;
        for [loud, ..] in scenes {
            side_lobe_db += side_lobe_db_of(&self.image(&mut imager, &[(loud, 1.0)], 0.0)?) / scenes.len() as f64;
        }
        let loud_db =
            20.0 * (f64::from(self.image(&mut imager, &[(&scenes[0][0], 1.0)], 0.0)?.peak().1) / LOUD).log10();
        let noise_db = noise_db(&self.image(&mut imager, &[(&scenes[0][0], 1.0)], 1.0)?);
        let mut weakest_db = [0.0_f64; 2];
        for (which, weakest_db) in weakest_db.iter_mut().enumerate() {
            *weakest_db = f64::NEG_INFINITY;
            for (scene, [loud_deg, weak_deg]) in scenes.iter().zip(PLACES_DEG) {
                let place = (weak_deg, if which == 0 { RANGE_M } else { BEHIND_M });
                let found = self.weakest_db(&mut imager, [&scene[0], &scene[1 + which]], loud_deg, place)?;
                *weakest_db = weakest_db.max(found);
            }
        }
        let [loud, beside, behind] = &scenes[0];
        let shown = [(&loud[..], 1.0), (&beside[..], gain(-15)), (&behind[..], gain(-25))];
        let mut times_ms = Vec::new();
        let mut image = None;
        for _ in 0..TIMED {
            let pings = self.mixed(&shown, 1.0);
            let start = Instant::now();
            image = Some(imager.image(&pings)?.energyscapes[0].clone());
            times_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times_ms.sort_by(f64::total_cmp);
        let image = image.ok_or_else(|| ServiceError::Internal("no image".to_owned()))?;
        let [beside_db, behind_db] = weakest_db;
        let time_ms = times_ms[TIMED / 2];
        Ok(Quality {
            name: candidate.name,
            loud_db,
            width_deg,
            side_lobe_db,
            noise_db,
            beside_db,
            behind_db,
            time_ms,
            image,
        })
    }

    fn mixed(&self, parts: &[(&[f32], f64)], noise: f64) -> PingSet {
        let mut pings = self.blank.clone();
        let mixed = samples(&mut pings);
        mixed.iter_mut().zip(&self.noise).for_each(|(to, value)| *to = value * noise as f32);
        for (part, gain) in parts {
            mixed.iter_mut().zip(*part).for_each(|(to, value)| *to += value * (gain * LOUD) as f32);
        }
        pings
    }

    fn image(&self, imager: &mut Imager, parts: &[(&[f32], f64)], noise: f64) -> Result<Energyscape, ServiceError> {
        Ok(imager.image(&self.mixed(parts, noise))?.energyscapes[0].clone())
    }

    /// Weakest level down to which the second echo is the second-highest peak at every step; 0 if at none.
    fn weakest_db(
        &self,
        imager: &mut Imager,
        [loud, weak]: [&[f32]; 2],
        loud_deg: f64,
        (weak_deg, weak_m): (f64, f64),
    ) -> Result<f64, ServiceError> {
        let mut weakest_db = 0;
        for level_db in (WEAKEST_DB..0).rev().filter(|level_db| level_db % STEP_DB == 0) {
            let image = self.image(imager, &[(loud, 1.0), (weak, gain(level_db))], 1.0)?;
            let grid = &image.grid;
            let away = |cell: usize| {
                let (direction, range) = grid.direction_and_range(cell);
                let bearing_deg = grid.directions()[direction].azimuth_rad.to_degrees();
                ((bearing_deg - loud_deg).abs() > MAIN_LOBE_DEG).then_some((bearing_deg, grid.range_m(range)))
            };
            let outside = image.values.iter().enumerate().filter_map(|(cell, value)| Some((away(cell)?, *value)));
            let highest = outside.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(place, _)| place);
            let is_it = |(bearing_deg, range_m): (f64, f64)| {
                (bearing_deg - weak_deg).abs() < SAME_DEG && (range_m - weak_m).abs() < SAME_M
            };
            if !highest.is_some_and(is_it) {
                break;
            }
            weakest_db = level_db;
        }
        Ok(f64::from(weakest_db))
    }
}

fn gain(level_db: i32) -> f64 {
    10_f64.powf(f64::from(level_db) / 20.0)
}

fn setup_of(config: &Config, candidate: &Candidate) -> Result<SensingSetup, ServiceError> {
    let Candidate { beamformer, multiply_order, coherence, apodization, focus_to_m, clean_rounds, .. } = *candidate;
    let imaging = ImagingParams {
        beamformer,
        multiply_order,
        coherence,
        apodization,
        focus_to_m,
        clean_rounds,
        ..config.imaging.clone()
    };
    Ok(wiring::sensing(&Config { imaging, ..config.clone() })?)
}

fn imager(setup: &SensingSetup, prefer: Prefer) -> Result<Imager, ServiceError> {
    let options = ImagerOptions { gpu_deadline_ms: 60_000, ..ImagerOptions::default() };
    Ok(Imager::open(Arc::clone(&setup.plan), Arc::new(MaskTable::default()), prefer, options)?)
}

/// A world with one thin pillar, whose surface is that far away, and silence about it.
pub(super) fn thin_pillar(bearing_deg: f64, range_m: f64) -> (World, SimParams) {
    let radius_m = 0.01;
    let (sin, cos) = bearing_deg.to_radians().sin_cos();
    let reach_m = range_m + radius_m;
    let pillar = Pillar { centre: [reach_m * cos, reach_m * sin], radius_m };
    let acoustics = SimParams { noise_rms: 0.0, direct_amplitude: 0.0, ..SimParams::default() };
    (World { pillars: vec![pillar], ..World::default() }, acoustics)
}

/// Its ping.
fn single_echo(config: &Config, setup: &SensingSetup, bearing_deg: f64, range_m: f64) -> Result<PingSet, ServiceError> {
    let (world, acoustics) = thin_pillar(bearing_deg, range_m);
    let mut simulator = simulator(config, setup, world, acoustics, 1)?;
    let mut pings = simulator.empty_ping_set();
    simulator.ping_set(Stamp::default(), &mut pings);
    Ok(pings)
}

fn samples(pings: &mut PingSet) -> &mut [f32] {
    match pings.pings[0].samples_mut() {
        Samples::PcmF32(values) => values,
        _ => &mut [],
    }
}

/// The highest of every direction near the range of the peak, and the direction of the peak.
fn profile(image: &Energyscape) -> (Vec<f64>, usize) {
    let grid = &image.grid;
    let (direction, range) = grid.direction_and_range(image.peak().0);
    let near = range.saturating_sub(30)..(range + 31).min(grid.range_count());
    let highest = |direction: usize| {
        near.clone().map(|range| f64::from(image.values[grid.cell(direction, range)])).fold(0.0, f64::max)
    };
    ((0..grid.direction_count()).map(highest).collect(), direction)
}

/// Width at half the peak, between directions by straight lines.
fn width_deg(image: &Energyscape) -> f64 {
    let (profile, peak) = profile(image);
    let bearing_deg = |index: usize| image.grid.directions()[index].azimuth_rad.to_degrees();
    let half = 0.5 * profile[peak];
    let crossing = |indices: &mut dyn Iterator<Item = usize>| {
        let mut inner = peak;
        for index in indices {
            if profile[index] < half {
                let share = (profile[inner] - half) / (profile[inner] - profile[index]);
                return bearing_deg(inner) + share * (bearing_deg(index) - bearing_deg(inner));
            }
            inner = index;
        }
        bearing_deg(inner)
    };
    (crossing(&mut (peak + 1..profile.len())) - crossing(&mut (0..peak).rev())).abs()
}

/// The highest beyond the first minimum to either side.
fn side_lobe_db_of(image: &Energyscape) -> f64 {
    let (profile, peak) = profile(image);
    let beyond = |indices: Vec<usize>| {
        let fall = indices.windows(2).position(|pair| profile[pair[1]] > profile[pair[0]]).unwrap_or(indices.len());
        indices[fall.min(indices.len())..].iter().map(|index| profile[*index]).fold(0.0, f64::max)
    };
    let highest = beyond((peak..profile.len()).collect()).max(beyond((0..=peak).rev().collect()));
    20.0 * (highest / profile[peak]).max(1e-10).log10()
}

/// Root mean square half a metre and more behind the peak, against it.
fn noise_db(image: &Energyscape) -> f64 {
    let grid = &image.grid;
    let (cell, peak) = image.peak();
    let range_m = grid.range_m(grid.direction_and_range(cell).1);
    let quiet = image
        .values
        .iter()
        .enumerate()
        .filter(|(cell, _)| grid.range_m(grid.direction_and_range(*cell).1) > range_m + 0.5);
    let (sum, count) = quiet.fold((0.0, 0), |(sum, count), (_, value)| (sum + f64::from(*value).powi(2), count + 1));
    20.0 * ((sum / f64::from(count.max(1))).sqrt() / f64::from(peak)).max(1e-10).log10()
}
