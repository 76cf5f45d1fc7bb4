//! The layout studio: candidate sensor layouts for a robot, their score from many drives, and their rank.
//!
//! Goes in: a robot, a number, a seed; then the runs of all candidates. Comes out: candidates ([`draw`]) and their order
//! ([`rank`]). Drives nothing itself ([`super::proving`] does), draws no picture and knows no command line.
//!
//! A candidate has one to three sensors on the robot's deck, each within the footprint or at its rim. Three of four are
//! mirror images of themselves about the robot's axis, as builders like them. What could not be built (housings in one
//! another) or could not drive (too little of the way ahead is seen, or the self-test fails) is drawn anew.

use super::ServiceError;
use super::proving::{Entrant, Run};
use super::trial::{TrackPoint, TrialOptions, TrialRig};
use crate::config::Config;
use crate::flow::View;
use crate::geometry::{Pose2, polar_from_cartesian, wrap_angle_rad};
use crate::parameter::ParameterError;
use crate::sensor::dead_zone::{self, HOUSING_DEPTH_M, HOUSING_WIDTH_M};
use crate::sensor::{Mount, MountParams, SensorParams};
use crate::signal::SENSORS_MAX;
use crate::sim::World;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::cmp::Ordering;

/// A clearance below this is a near-miss.
pub const NEAR_MISS_M: f64 = 0.1;
/// Draws for one candidate before it is given up.
const DRAWS_MAX: usize = 400;
/// Share of candidates that are symmetrical, of sensors at the rim, and of lone sensors on the axis that look ahead.
const SYMMETRICAL_SHARE: f64 = 0.75;
const RIM_SHARE: f64 = 0.6;
const AHEAD_SHARE: f64 = 0.75;
/// Places and angles are drawn in steps that a person can set with ruler and protractor.
const PLACE_STEP_M: f64 = 0.005;
const ANGLE_STEP_DEG: f64 = 5.0;
/// Distance from the footprint's rim at which it is counted how much around the robot is seen.
const AROUND_M: f64 = 0.5;
/// Bins of a turn in the table of what is seen.
const BEARING_BINS: usize = 720;

/// Draws `count` different candidates for the robot of `config`; the same seed gives the same ones. `drawn` is called after
/// each.
///
/// # Errors
/// When no layout can be found that this robot could drive with.
pub fn draw(config: &Config, count: usize, seed: u64, drawn: &mut dyn FnMut()) -> Result<Vec<Entrant>, ServiceError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(2);
    let mut tried = vec![config.sensor.iter().map(|sensor| sensor.mount).collect()];
    let one = |number| {
        let entrant = draw_one(config, &format!("drawn-{number}"), &mut tried, &mut random)?;
        drawn();
        Ok(entrant)
    };
    (1..=count).map(one).collect()
}

fn draw_one(
    config: &Config,
    name: &str,
    tried: &mut Vec<Vec<MountParams>>,
    random: &mut ChaCha8Rng,
) -> Result<Entrant, ServiceError> {
    // There are fewer ways to place one sensor than three: a sixth, a third and a half of the candidates. Both are decided
    // before anything is refused, or the layouts that are refused least would be drawn most.
    let count = [1, 2, 2, SENSORS_MAX, SENSORS_MAX, SENSORS_MAX][(6.0 * random.random::<f64>()) as usize];
    let symmetrical = random.random::<f64>() < SYMMETRICAL_SHARE;
    for _ in 0..DRAWS_MAX {
        let places = draw_places(count, symmetrical, config.platform.radius_m, random);
        if !can_be_built(&places) || !places.iter().any(looks_ahead) {
            continue;
        }
        let mut config = config.clone();
        config.sensor = sensors(&places, &config.sensor);
        let mounts: Vec<MountParams> = config.sensor.iter().map(|sensor| sensor.mount).collect();
        if tried.contains(&mounts) {
            continue;
        }
        tried.push(mounts);
        if config.validate().is_err() {
            continue;
        }
        // A region that nothing sees makes a layout useless, not the sweep.
        let Ok(rig) = TrialRig::new(config) else { continue };
        let used = std::array::from_fn(|index| index < places.len());
        if rig.masks().coverage(used).ahead_m >= rig.config().platform.radius_m && can_be_armed(&rig) {
            return Ok(Entrant { name: name.to_owned(), rig, losses: Vec::new() });
        }
    }
    let found = format!("{} m", config.platform.radius_m);
    let allowed = format!("a robot on which one of {DRAWS_MAX} random sensor layouts sees the way ahead");
    Err(ParameterError::new("platform.radius_m", found, allowed).into())
}

/// Whether the daemon's self-test passes in an empty world: sensors that shout into each other's faces fail it everywhere.
fn can_be_armed(rig: &TrialRig) -> bool {
    let empty = World { time_limit_s: 0.1, ..World::default() };
    rig.run(empty, &TrialOptions::default(), &mut |_| false).is_ok()
}

/// A sensor's place and heading, robot frame: metres, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Place {
    distance_m: f64,
    bearing_deg: f64,
    heading_deg: f64,
}

impl Place {
    fn mirrored(self) -> Self {
        Self { bearing_deg: -self.bearing_deg, heading_deg: -self.heading_deg, ..self }
    }

    fn pose(&self) -> Pose2 {
        let (sin, cos) = self.bearing_deg.to_radians().sin_cos();
        let heading_rad = self.heading_deg.to_radians();
        Pose2 { x_m: self.distance_m * cos, y_m: self.distance_m * sin, heading_rad }
    }
}

fn draw_places(count: usize, symmetrical: bool, radius_m: f64, random: &mut ChaCha8Rng) -> Vec<Place> {
    if !symmetrical {
        return (0..count).map(|_| draw_place(radius_m, random)).collect();
    }
    let mut places = Vec::new();
    if count % 2 == 1 {
        let ahead = count == 1 || random.random::<f64>() < AHEAD_SHARE;
        let place = draw_place(radius_m, random);
        let bearing_deg = if place.bearing_deg.abs() < 90.0 { 0.0 } else { 180.0 };
        places.push(Place { bearing_deg, heading_deg: if ahead { 0.0 } else { 180.0 }, ..place });
    }
    if count > 1 {
        let place = draw_place(radius_m, random);
        places.extend([place, place.mirrored()]);
    }
    places
}

fn draw_place(radius_m: f64, random: &mut ChaCha8Rng) -> Place {
    // Uniform over the disc, not over its radius.
    let within_m = radius_m * random.random::<f64>().sqrt();
    let distance_m = if random.random::<f64>() < RIM_SHARE { radius_m } else { within_m };
    let angle_deg = |random: &mut ChaCha8Rng| round_to(360.0 * random.random::<f64>() - 180.0, ANGLE_STEP_DEG);
    Place {
        distance_m: round_to(distance_m, PLACE_STEP_M).min(radius_m),
        bearing_deg: angle_deg(random),
        heading_deg: angle_deg(random),
    }
}

fn round_to(value: f64, step: f64) -> f64 {
    let steps = (value / step).round();
    // Dividing by the whole number of steps in one keeps 0.15 from becoming 0.15000000000000002.
    if step < 1.0 { steps / (1.0 / step).round() } else { steps * step }
}

/// Whether no housing stands in another.
fn can_be_built(places: &[Place]) -> bool {
    let apart = |a: &Place, b: &Place| !housing_points_m(a).any(|point_m| in_housing(b, point_m));
    places.iter().enumerate().all(|(index, a)| places[..index].iter().all(|b| apart(a, b) && apart(b, a)))
}

/// Points all over a housing's outline and middle line, 1 cm apart or less.
fn housing_points_m(place: &Place) -> impl Iterator<Item = Vector2<f64>> {
    let pose = place.pose();
    (0..=12).flat_map(move |across| {
        (0..=5).map(move |along| {
            let y_m = (f64::from(across) / 12.0 - 0.5) * HOUSING_WIDTH_M;
            pose.parent_from_local(Vector2::new(-f64::from(along) / 5.0 * HOUSING_DEPTH_M, y_m))
        })
    })
}

fn in_housing(place: &Place, point_m: Vector2<f64>) -> bool {
    dead_zone::housing().contains(place.pose().local_from_parent(point_m))
}

/// Cheaper than the masks, which have the last word.
fn looks_ahead(place: &Place) -> bool {
    wrap_angle_rad(place.heading_deg.to_radians()).abs() < 80_f64.to_radians()
}

/// Sensors at those places, of the kind of the robot's first.
fn sensors(places: &[Place], present: &[SensorParams]) -> Vec<SensorParams> {
    let sensor = |(index, place): (usize, &Place)| {
        let yaw_deg = wrap_angle_rad((place.heading_deg - place.bearing_deg).to_radians()).to_degrees();
        let yaw_deg = round_to(yaw_deg, ANGLE_STEP_DEG);
        let name = format!("sonar{}", index + 1);
        let mut sensor = SensorParams::ertis(&name, place.distance_m, place.bearing_deg, yaw_deg);
        if let Some(first) = present.first() {
            sensor.array.clone_from(&first.array);
            sensor.emitter_m = first.emitter_m;
        }
        sensor
    };
    places.iter().enumerate().map(sensor).collect()
}

/// How much a layout sees, whatever the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coverage {
    /// Way ahead of the footprint that is seen over its whole width, at most 3 m.
    pub ahead_m: f64,
    /// The same behind it.
    pub behind_m: f64,
    /// Share of the bearings around the robot that are seen half a metre from the footprint's rim.
    pub around_share: f64,
}

/// How the drives of one layout went.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepScore {
    /// Runs.
    pub runs: usize,
    /// Of these, runs that ended in contact.
    pub contacts: usize,
    /// Runs that did not reach the goal, those that could not begin included.
    pub goals_missed: usize,
    /// Runs that could not begin.
    pub failed: usize,
    /// Times that the clearance fell below [`NEAR_MISS_M`].
    pub near_misses: usize,
    /// Mean duration of the runs that reached the goal.
    pub time_to_goal_s: Option<f64>,
    /// Smallest clearance.
    pub min_clearance_m: Option<f64>,
    /// Median of the clearance over all ping sets.
    pub median_clearance_m: Option<f64>,
    /// How much is seen.
    pub coverage: Coverage,
}

impl SweepScore {
    /// Scores the runs of `entrant`.
    #[must_use]
    pub fn of<'a>(entrant: &Entrant, runs: impl Iterator<Item = &'a Run>) -> Self {
        let mut score = Self {
            runs: 0,
            contacts: 0,
            goals_missed: 0,
            failed: 0,
            near_misses: 0,
            time_to_goal_s: None,
            min_clearance_m: None,
            median_clearance_m: None,
            coverage: Sight::new(&entrant.rig).coverage(),
        };
        let (mut times_s, mut clearances_m) = (Vec::new(), Vec::new());
        for run in runs {
            score.runs += 1;
            let Ok(trial) = &run.outcome else {
                score.failed += 1;
                score.goals_missed += 1;
                continue;
            };
            score.contacts += usize::from(trial.score.collided);
            score.goals_missed += usize::from(!trial.score.reached_goal);
            score.near_misses += near_misses(&trial.track);
            if trial.score.reached_goal {
                times_s.push(trial.score.duration_s);
            }
            let least_m = trial.score.min_clearance_m;
            score.min_clearance_m = Some(score.min_clearance_m.map_or(least_m, |least| least.min(least_m)));
            clearances_m.extend(trial.track.iter().map(|point| point.clearance_m));
        }
        score.time_to_goal_s = (!times_s.is_empty()).then(|| times_s.iter().sum::<f64>() / times_s.len() as f64);
        clearances_m.sort_by(f64::total_cmp);
        score.median_clearance_m = clearances_m.get(clearances_m.len() / 2).copied();
        score
    }

    /// The better score first: fewer contacts, then fewer goals missed, then fewer near-misses, then the shorter mean time to
    /// the goal, then the larger of the least clearances.
    #[must_use]
    pub fn compare(&self, other: &Self) -> Ordering {
        let counts = |score: &Self| (score.contacts, score.goals_missed, score.near_misses);
        let time_s = |score: &Self| score.time_to_goal_s.unwrap_or(f64::INFINITY);
        let clearance_m = |score: &Self| score.min_clearance_m.unwrap_or(f64::NEG_INFINITY);
        counts(self)
            .cmp(&counts(other))
            .then_with(|| time_s(self).total_cmp(&time_s(other)))
            .then_with(|| clearance_m(other).total_cmp(&clearance_m(self)))
    }
}

fn near_misses(track: &[TrackPoint]) -> usize {
    let near = |point: &TrackPoint| point.clearance_m < NEAR_MISS_M;
    let began_near = usize::from(track.first().is_some_and(near));
    began_near + track.windows(2).filter(|pair| !near(&pair[0]) && near(&pair[1])).count()
}

/// Index of each entrant with its score, best first; equal ones keep the order of the entrants.
#[must_use]
pub fn rank(entrants: &[Entrant], runs: &[Run]) -> Vec<(usize, SweepScore)> {
    let of = |index: usize| runs.iter().filter(move |run| run.entrant == index);
    let mut ranking: Vec<(usize, SweepScore)> =
        entrants.iter().enumerate().map(|(index, entrant)| (index, SweepScore::of(entrant, of(index)))).collect();
    ranking.sort_by(|a, b| a.1.compare(&b.1));
    ranking
}

/// Which sensors see a place near the robot: within the ranges of the image and a direction that nothing hides.
pub struct Sight<'a> {
    rig: &'a TrialRig,
    /// Pose of each sensor, and for each bearing from it whether it sees there.
    views: Vec<(Pose2, Vec<bool>)>,
    ranges_m: (f64, f64),
}

impl<'a> Sight<'a> {
    /// What the sensors of a robot see.
    #[must_use]
    pub fn new(rig: &'a TrialRig) -> Self {
        let plan = &rig.setup().plan;
        let grid = &plan.grid;
        let mounts: Vec<Mount> = rig.setup().sensors.iter().map(|sensor| sensor.mount).collect();
        let hidden = rig.setup().hidden_directions();
        let view = View::new(grid, &mounts, &hidden);
        let bins = |sensor| (0..BEARING_BINS).map(|bin| view.sees_bearing(sensor, bearing_of_rad(bin))).collect();
        let views = mounts.iter().enumerate().map(|(sensor, mount)| (mount.pose(), bins(sensor))).collect();
        Self { rig, views, ranges_m: (grid.range_first_m(), grid.range_m(grid.range_count() - 1)) }
    }

    /// Number of sensors that see a point of the robot frame.
    #[must_use]
    pub fn seen_by(&self, point_m: Vector2<f64>) -> usize {
        let sees = |(pose, bins): &&(Pose2, Vec<bool>)| {
            let (range_m, bearing_rad) = polar_from_cartesian(pose.local_from_parent(point_m));
            range_m >= self.ranges_m.0 && range_m <= self.ranges_m.1 && bins[bin(bearing_rad)]
        };
        self.views.iter().filter(sees).count()
    }

    /// How much is seen in all.
    #[must_use]
    pub fn coverage(&self) -> Coverage {
        let used = std::array::from_fn(|index| index < self.views.len());
        let cue = self.rig.masks().coverage(used);
        let ring_m = self.rig.config().platform.radius_m + AROUND_M;
        let seen = |degree: &i32| {
            let (sin, cos) = f64::from(*degree).to_radians().sin_cos();
            self.seen_by(Vector2::new(cos, sin) * ring_m) > 0
        };
        let around_share = (0..360).filter(seen).count() as f64 / 360.0;
        Coverage { ahead_m: cue.ahead_m, behind_m: cue.behind_m, around_share }
    }
}

/// Bearing of the middle of a bin.
fn bearing_of_rad(bin: usize) -> f64 {
    ((bin as f64 + 0.5) / BEARING_BINS as f64 - 0.5) * std::f64::consts::TAU
}

fn bin(bearing_rad: f64) -> usize {
    let turn = wrap_angle_rad(bearing_rad) / std::f64::consts::TAU + 0.5;
    ((turn * BEARING_BINS as f64) as usize).min(BEARING_BINS - 1)
}
