//! What an emission plan is worth: cross-talk between sensors, and what is done against it, in simulated rooms.
//!
//! In: a configuration, of which sensors, sweep, format and grid are taken, and the number of places. Out: a [`Judgement`] a plan: how far
//! a foreign sweep stays below one's own, what the image loses for it, and how many echoes are seen that nobody of one's own sent
//! ([`Tally`]). The truth is the same ping without the other sensors' sound; simulator, imaging and reflectors are the daemon's own.
//! Draws nothing, reads no clock.

mod scenes;

pub use scenes::{ROOMS, Room, facing, fan, rooms};

use super::image_quality::thin_pillar;
use super::wiring::{self, SensingSetup};
use super::{ServiceError, crew, scanning, simulator};
use crate::config::Config;
use crate::detect::reflectors::{REFLECTORS_MAX, Reflector};
use crate::detect::vertex;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::sensor::{EmissionParams, EmissionPlan, MountParams, RecordingParams, SensorEmission, SensorParams, Sweeps};
use crate::signal::{Energyscape, MaskTable, PingSet, SampleFormat};
use crate::sim::{SimParams, Simulator};
use crate::time::Stamp;
use scenes::{Place, Scene, free_way_m};
use std::sync::Arc;

/// An echo is looked for within these. An own echo is moved by what interferes with it by a share of its width at most: the
/// widest that is compared here is 4 cm at half its amplitude, and a beam is 10 degrees wide. Two noises of the same ping without
/// cross-talk differ by fewer echoes than a tenth of what is counted with it (the test says so).
const SAME_M: f64 = 0.06;
const SAME_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// An echo is known where the other image shows at least this share of it: what is only just below the floor in one of two pings and
/// above it in the other is no difference.
const KNOWN_SHARE: f32 = 0.5;
/// A ghost stands in the way if it is nearer than whatever really stands in its direction by more than this.
const IN_THE_WAY_M: f64 = 0.15;
/// Where the single echo stands by which sweeps are compared, and the step of ranges it is looked at with.
const SINGLE_M: f64 = 2.0;
const FINE_STEP_M: f64 = 2e-3;
/// Stamp of the first ping set.
const START_NS: u64 = 1_000_000_000;

/// A plan under a name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// For tables and pictures.
    pub name: &'static str,
    /// When the sensors fire.
    pub plan: EmissionPlan,
    /// What they send.
    pub sweeps: Sweeps,
}

/// All plans that are compared, the default first.
pub const CANDIDATES: [Candidate; 5] = [
    Candidate { name: "together, same sweep", plan: EmissionPlan::Together, sweeps: Sweeps::Same },
    Candidate { name: "together, alternate", plan: EmissionPlan::Together, sweeps: Sweeps::Alternate },
    Candidate { name: "together, bands", plan: EmissionPlan::Together, sweeps: Sweeps::Bands },
    Candidate { name: "in turn, same sweep", plan: EmissionPlan::InTurn, sweeps: Sweeps::Same },
    Candidate { name: "in turn, bands", plan: EmissionPlan::InTurn, sweeps: Sweeps::Bands },
];

/// What was counted in some pings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Ping sets heard.
    pub sets: usize,
    /// Echoes of the sensors' own emissions.
    pub echoes: usize,
    /// Echoes seen where a sensor's own emission alone shows less than half as much.
    pub ghosts: usize,
    /// Those of them that are nearer than whatever stands in their direction: the robot would brake or turn for nothing.
    pub in_the_way: usize,
    /// Own echoes that are not seen with the others' sound.
    pub misses: usize,
}

impl Tally {
    fn add(&mut self, other: &Tally) {
        self.sets += other.sets;
        self.echoes += other.echoes;
        self.ghosts += other.ghosts;
        self.in_the_way += other.in_the_way;
        self.misses += other.misses;
    }

    /// A count for a hundred ping sets.
    #[must_use]
    pub fn per_hundred(&self, count: usize) -> f64 {
        100.0 * count as f64 / self.sets.max(1) as f64
    }
}

/// How the sweeps of a plan go together, by a single echo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sharpness {
    /// By how much the least different foreign sweep stays below a sensor's own, both from the same place; `None` where all are the same.
    pub rejection_db: Option<f64>,
    /// Width in range of an echo at half its amplitude, the widest of the sensors.
    pub width_m: f64,
    /// Error of its range, the largest of the sensors.
    pub range_error_m: f64,
}

/// What was found of one plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// Its name.
    pub name: &'static str,
    /// By a single echo.
    pub sharpness: Sharpness,
    /// From the first emission of a set to the last one.
    pub added_s: f64,
    /// The configured robot in the rooms.
    pub robot: Tally,
    /// The same without anybody else's sound, and with other noise: the error of the count.
    pub noise: Tally,
    /// A robot whose sensors all look ahead, in the same rooms.
    pub fan: Tally,
    /// Another robot that looks this way and fires when it likes; `None` in turn, which is no agreement between robots.
    pub facing: Option<Tally>,
}

/// One image with and without the others' sound.
#[derive(Debug, Clone)]
pub struct Shown {
    /// Index of the sensor.
    pub sensor: usize,
    /// A sensor's own emission alone.
    pub own: Energyscape,
    /// With the others' sound.
    pub heard: Energyscape,
    /// Ghosts in it.
    pub ghosts: usize,
}

/// A configuration that follows a candidate.
#[must_use]
pub fn configured(config: &Config, candidate: &Candidate) -> Config {
    let mut config = config.clone();
    (config.emission.plan, config.emission.sweeps, config.emission.slot_s) = (candidate.plan, candidate.sweeps, None);
    config.sensor.iter_mut().for_each(|sensor| sensor.emission = None);
    config
}

/// Judges one plan on `places` places of each room, on `jobs` threads.
///
/// # Errors
/// When the configuration cannot be planned for or simulated with it: turns that do not fit the ping period, for example.
pub fn judge(config: &Config, candidate: &Candidate, places: usize, jobs: usize) -> Result<Judgement, ServiceError> {
    let robot = configured(config, candidate);
    robot.validate()?;
    let fan = fan(&robot);
    let in_turn = candidate.plan == EmissionPlan::InTurn;
    let facing = if in_turn { None } else { Some(tally(&facing(&robot, places), jobs, Sound::Cross)?) };
    let rooms_of_robot = rooms(&robot, places)?;
    Ok(Judgement {
        name: candidate.name,
        sharpness: sharpness(&robot)?,
        added_s: robot.slot_s() * robot.sensor.len().saturating_sub(1) as f64,
        robot: tally(&rooms_of_robot, jobs, Sound::Cross)?,
        noise: tally(&rooms_of_robot, jobs, Sound::OtherNoise)?,
        fan: tally(&rooms(&fan, places)?, jobs, Sound::Cross)?,
        facing,
    })
}

/// What is compared with the sensors' own sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sound {
    /// The same with the sound of the others.
    Cross,
    /// Their own sound again, with other noise: what is counted then is the error of the count.
    OtherNoise,
}

/// Counts over all scenes.
///
/// # Errors
/// When one cannot be simulated.
pub fn tally(scenes: &[Scene], jobs: usize, sound: Sound) -> Result<Tally, ServiceError> {
    let work = |(): &mut (), index: usize| Heard::new(&scenes[index], sound).map(|heard| heard.tally(&scenes[index]));
    let counted = crew::work_off(scenes.len(), jobs, "noctule-trial", || (), work, &mut |_| ())?;
    let mut sum = Tally::default();
    for counted in counted {
        sum.add(&counted?);
    }
    Ok(sum)
}

/// The images of one sensor of a scene; unless it is said which, of the one with most ghosts.
///
/// # Errors
/// When the scene cannot be simulated.
pub fn show(scene: &Scene, sensor: Option<usize>) -> Result<Shown, ServiceError> {
    let heard = Heard::new(scene, Sound::Cross)?;
    let ghosts = |sensor: usize| heard.ghosts(sensor).count();
    let worst = || (0..scene.judged).max_by_key(|sensor| (ghosts(*sensor), usize::MAX - sensor)).unwrap_or(0);
    let sensor = sensor.filter(|sensor| *sensor < scene.judged).unwrap_or_else(worst);
    let image = |images: &[Energyscape]| images[sensor].clone();
    Ok(Shown { sensor, own: image(&heard.own.images), heard: image(&heard.all.images), ghosts: ghosts(sensor) })
}

/// Images of one ping set, and the echoes that they show.
struct Seen {
    images: Vec<Energyscape>,
    /// A sensor each.
    echoes: Vec<Vec<Reflector>>,
}

impl Seen {
    /// Whether an echo found elsewhere is in a sensor's image, too.
    fn knows(&self, sensor: usize, echo: &Reflector) -> bool {
        let image = &self.images[sensor];
        let grid = &image.grid;
        let bin = |range_m: f64| ((range_m - grid.range_first_m()) / grid.range_step_m()).max(0.0);
        let first = bin(echo.range_m - SAME_M).ceil() as usize;
        let end = (bin(echo.range_m + SAME_M) as usize + 1).min(grid.range_count());
        let near = |direction: &usize| {
            (grid.directions()[*direction].azimuth_rad - echo.bearing_rad).abs() <= SAME_RAD && first < end
        };
        let rows = (0..grid.direction_count()).filter(near);
        let mut cells = rows.flat_map(|direction| &image.values[grid.cell(direction, first)..][..end - first]);
        cells.any(|value| *value >= KNOWN_SHARE * echo.energy)
    }
}

/// A scene heard with and without the others' sound.
struct Heard {
    own: Seen,
    all: Seen,
}

impl Heard {
    fn new(scene: &Scene, sound: Sound) -> Result<Self, ServiceError> {
        let setup = wiring::sensing(&scene.config)?;
        let mut imager = imager(&setup)?;
        let own = scene.acoustics(false);
        let (other, seed) = match sound {
            Sound::Cross => (scene.acoustics(true), scene.seed),
            Sound::OtherNoise => (own, scene.seed + 1_000_000),
        };
        let mut seen = |acoustics: SimParams, seed: u64| -> Result<Seen, ServiceError> {
            let mut simulator = simulator(&scene.config, &setup, scene.world.clone(), acoustics, seed)?;
            if let Place::At(pose) = scene.place {
                simulator.set_pose(pose);
            }
            let pings = second_set(&mut simulator);
            seen(&scene.config, &setup, &mut imager, &pings)
        };
        Ok(Self { own: seen(own, scene.seed)?, all: seen(other, seed)? })
    }

    /// What is seen only with the others' sound.
    fn ghosts(&self, sensor: usize) -> impl Iterator<Item = &Reflector> {
        self.all.echoes[sensor].iter().filter(move |echo| !self.own.knows(sensor, echo))
    }

    fn tally(&self, scene: &Scene) -> Tally {
        let mut tally = Tally { sets: 1, ..Tally::default() };
        for sensor in 0..scene.judged {
            let own = &self.own.echoes[sensor];
            let missed = |echo: &&Reflector| !self.all.knows(sensor, echo);
            tally.echoes += own.len();
            tally.misses += own.iter().filter(missed).count();
            for ghost in self.ghosts(sensor) {
                tally.ghosts += 1;
                let free_m = free_way_m(scene, sensor, ghost.bearing_rad);
                tally.in_the_way += usize::from(ghost.range_m + IN_THE_WAY_M < free_m);
            }
        }
        tally
    }
}

/// The second set of a robot that stands: what the first one left in the air is in it.
fn second_set(simulator: &mut Simulator) -> PingSet {
    let mut pings = simulator.empty_ping_set();
    for _ in 0..2 {
        simulator.ping_set(Stamp { boottime_ns: START_NS, wall_ns: START_NS }, &mut pings);
    }
    pings
}

fn seen(config: &Config, setup: &SensingSetup, imager: &mut Imager, pings: &PingSet) -> Result<Seen, ServiceError> {
    let images = imager.image(pings)?.energyscapes.clone();
    let mut echoes = Vec::new();
    for (image, mut finder) in images.iter().zip(scanning::reflector_finders(config, setup)) {
        let mut found = Vec::with_capacity(REFLECTORS_MAX);
        finder.find(&image.values, &mut found);
        echoes.push(found);
    }
    Ok(Seen { images, echoes })
}

fn imager(setup: &SensingSetup) -> Result<Imager, ServiceError> {
    let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
    Ok(Imager::open(Arc::clone(&setup.plan), Arc::new(MaskTable::default()), Prefer::Cpu, options)?)
}

/// Every sweep of a plan by the echo of a thin pillar, imaged with its own reference and with each other one.
///
/// # Errors
/// When the configuration cannot be planned for or simulated.
pub fn sharpness(config: &Config) -> Result<Sharpness, ServiceError> {
    let count = config.sensor.len();
    let singles: Vec<Config> = (0..count).map(|index| single(config, index)).collect();
    let mut heard = Vec::new();
    let mut setups = Vec::new();
    for config in &singles {
        let setup = wiring::sensing(config)?;
        heard.push(echo_of_pillar(config, &setup)?);
        setups.push(setup);
    }
    let mut worst = Sharpness { rejection_db: None, width_m: 0.0, range_error_m: 0.0 };
    for own in 0..count {
        let mut imager = imager(&setups[own])?;
        let image = imager.image(&heard[own])?.energyscapes[0].clone();
        let (range_m, width_m, peak) = peak_in_range(&image);
        worst.width_m = worst.width_m.max(width_m);
        worst.range_error_m = worst.range_error_m.max((range_m - SINGLE_M).abs());
        for foreign in (0..count).filter(|foreign| config.emission_of(*foreign) != config.emission_of(own)) {
            let leaked = f64::from(imager.image(&heard[foreign])?.energyscapes[0].peak().1);
            let below_db = 20.0 * (peak / leaked.max(1e-12)).log10();
            worst.rejection_db = Some(worst.rejection_db.map_or(below_db, |least: f64| least.min(below_db)));
        }
    }
    Ok(worst)
}

/// A sensor's emission that leaves nothing to the common one.
fn whole(params: &EmissionParams) -> SensorEmission {
    SensorEmission {
        shape: Some(params.shape),
        start_hz: Some(params.start_hz),
        end_hz: Some(params.end_hz),
        duration_s: Some(params.duration_s),
        taper: Some(params.taper),
        file: params.file.clone(),
    }
}

/// Sensor `index` alone in the middle of the robot, with what it sends in the plan.
fn single(config: &Config, index: usize) -> Config {
    let own = whole(&config.emission_of(index));
    let mut config = configured(config, &CANDIDATES[0]);
    config.sensor =
        vec![SensorParams { mount: MountParams::default(), emission: Some(own), ..config.sensor[index].clone() }];
    config.obstruction.clear();
    // One-bit samples would hide a leak under their own noise.
    if let Ok(recording) = config.recording() {
        config.recording = RecordingParams {
            format: SampleFormat::PcmF32,
            sample_rate_hz: Some(recording.demodulated_rate_hz()),
            samples: Some(recording.demodulated_samples()),
            decimation: None,
        };
    }
    config.imaging.range_step_m = Some(FINE_STEP_M);
    config.imaging.range_max_m = config.imaging.range_max_m.max(1.2 * SINGLE_M);
    config
}

/// The ping of a thin pillar on boresight in silence.
fn echo_of_pillar(config: &Config, setup: &SensingSetup) -> Result<PingSet, ServiceError> {
    let (world, acoustics) = thin_pillar(0.0, SINGLE_M);
    Ok(second_set(&mut simulator(config, setup, world, acoustics, 1)?))
}

/// Range of the highest cell, by a parabola, the width of its hill at half its height, and the height.
fn peak_in_range(image: &Energyscape) -> (f64, f64, f64) {
    let (cell, peak) = image.peak();
    let (direction, range) = image.grid.direction_and_range(cell);
    let count = image.grid.range_count();
    let value = |index: usize| f64::from(image.values[image.grid.cell(direction, index.min(count - 1))]);
    let (before, at, after) = (value(range.saturating_sub(1)), f64::from(peak), value(range + 1));
    let shift = vertex(before, at, after);
    let half = 0.5 * at;
    let crossing = |indices: &mut dyn Iterator<Item = usize>| {
        let mut inner = range;
        for index in indices {
            if value(index) < half {
                let share = (value(inner) - half) / (value(inner) - value(index));
                return inner as f64 + share * (index as f64 - inner as f64);
            }
            inner = index;
        }
        inner as f64
    };
    let width = crossing(&mut (range + 1..count)) - crossing(&mut (0..range).rev());
    let step_m = image.grid.range_step_m();
    (image.grid.range_m(range) + shift * step_m, width * step_m, at)
}
