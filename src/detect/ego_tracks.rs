//! Reflectors followed from ping set to ping set: what they are (a wall, a point, something that moves) and where they go.
//!
//! Goes in: the reflectors of each sensor and how the robot moved. Comes out: the rates of those that were heard twice
//! ([`ReflectorRate`]), and those that move over ground ([`Movers`]). Each track is a Kalman filter of constant velocity over ground,
//! kept in the robot frame and turned with it, so that no frame of odometry can jump under it. What an echo of a thing at rest can do is
//! explained first: its range changes only by the robot's own motion, and its place slides along a surface by no more than the sensor
//! itself moves across the line of sight ([`super::ego_fit`]). Only what contradicts that for several ping sets moves. Somebody who
//! walks along beside the robot, as fast as it and abeam, cannot be told from a wall, and comes no nearer. Allocates nothing after it was
//! made.

use super::ego_fit::{EgoFit, RATES_MAX, ReflectorRate, expected, unknown_bend};
use super::reflectors::Reflector;
use crate::geometry::{Pose2, cartesian_from_polar, polar_from_cartesian, wrap_angle_rad};
use crate::sensor::Mount;
use crate::signal::{Mover, Movers, Velocity};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Rotation2, Vector2, Vector4};

/// Most tracks of all sensors.
pub const TRACKS_MAX: usize = 72;
/// How far off a reflector may be of where its track expects it; of a young one whose velocity is not known yet.
const GATE_M: f64 = 0.06;
const GATE_YOUNG_M: f64 = 0.12;
const GATE_RAD: f64 = 0.15;
/// And by which factor its amplitude may change, as a natural logarithm.
const GATE_ENERGY: f64 = 2.0;
const YOUNG: u32 = 4;
/// Ping sets that a track is kept without an echo.
const MISSES_MAX: u32 = 2;
/// What people do: accelerate like this, start no faster than this.
const ACCEL_M_S2: f64 = 0.25;
const START_SIGMA_M_S: f64 = 0.6;
/// Bearings of a hill wander by this much when others grow beside it.
const WANDER_RAD: f64 = 0.004;
const WANDER_M: f64 = 0.001;
/// What contradicts rest, in standard deviations (squared) and as a speed.
const CONTRADICTION: f64 = 9.0;
const SPEED_MIN_M_S: f64 = 0.1;
/// Standard deviations of the two parts of that speed beyond what the filter knows.
const RADIAL_SIGMA_M_S: f64 = 0.02;
const LATERAL_SIGMA_M_S: f64 = 0.05;
/// A bearing that is known no better says nothing of a motion across.
const SURE_RAD: f64 = 0.03;
/// Ping sets of contradiction that make a mover, and the most that are counted.
const MOVING_MIN: u32 = 4;
const MOVING_MAX: u32 = 7;
/// Mean squared innovation (two degrees of freedom) of a track that goes as the filter says.
const STEADY_MAX: f64 = 6.0;
/// Radius that a mover is taken to have: people's legs to shoulders. Sonar hears its nearest point alone.
const RADIUS_M: f64 = 0.2;
/// Two sensors hear one mover within this distance of each other.
const SAME_M: f64 = 0.5;
/// What is known of kappa gets no surer than this share of 1/r, and is forgotten at this rate per ping set.
const BEND_SHARE_MIN: f64 = 0.1;
const BEND_FORGOTTEN: f64 = 1.05;

/// One reflector over time.
#[derive(Debug, Clone, Copy)]
struct Track {
    id: u32,
    sensor: usize,
    /// Place in the robot frame, and velocity over ground along its axes.
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
    last: Reflector,
    /// Whether `last` is of the ping set before.
    fresh: bool,
    bend: [f64; 2],
    age: u32,
    misses: u32,
    moving: u32,
    /// Mean squared innovation, slowly forgotten.
    unrest: f64,
    matched: Option<usize>,
}

impl Track {
    fn place_m(&self) -> Vector2<f64> {
        self.state.fixed_rows::<2>(0).into()
    }

    fn velocity_m_s(&self) -> Vector2<f64> {
        self.state.fixed_rows::<2>(2).into()
    }

    fn is_mover(&self) -> bool {
        self.moving >= MOVING_MIN && self.unrest <= STEADY_MAX
    }
}

/// How the robot moved between two ping sets.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Mean velocity.
    pub velocity: Velocity,
    /// Its covariance.
    pub covariance: Matrix2<f64>,
    /// Time between the two.
    pub interval_s: f64,
}

impl Step {
    /// Pose of the robot after the step in its frame before.
    fn pose(&self) -> Pose2 {
        arc(self.velocity, self.interval_s)
    }
}

/// Where a robot is after driving at a constant velocity, in its frame before; a time below zero leads back.
#[must_use]
pub fn arc(velocity: Velocity, time_s: f64) -> Pose2 {
    let turn_rad = velocity.angular_rad_s * time_s;
    let way_m = velocity.linear_m_s * time_s;
    let half_rad = 0.5 * turn_rad;
    let chord_m = if half_rad.abs() < 1e-9 { way_m } else { way_m * half_rad.sin() / half_rad };
    Pose2 { x_m: chord_m * half_rad.cos(), y_m: chord_m * half_rad.sin(), heading_rad: turn_rad }
}

/// All tracks.
#[derive(Debug, Clone)]
pub struct EgoTracks {
    mounts: Vec<Mount>,
    tracks: Vec<Track>,
    /// Scratch: squared distance, track, reflector.
    pairs: Vec<(f64, usize, usize)>,
    next_id: u32,
    speed_of_sound_m_s: f64,
}

impl EgoTracks {
    /// No tracks yet, for sensors that stand like this.
    #[must_use]
    pub fn new(mounts: Vec<Mount>, speed_of_sound_m_s: f64) -> Self {
        let pairs = Vec::with_capacity(TRACKS_MAX * super::reflectors::REFLECTORS_MAX);
        Self { mounts, tracks: Vec::with_capacity(TRACKS_MAX), pairs, next_id: 1, speed_of_sound_m_s }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.tracks.clear();
    }

    /// Finds the tracks' reflectors again, which are of one sensor, if the robot moved about as `guess` says. Nearest pairs first.
    pub fn match_sensor(&mut self, sensor: usize, reflectors: &[Reflector], guess: &Step) {
        let Some(mount) = self.mounts.get(sensor) else { return };
        let (moved, ear) = (guess.pose(), mount.pose());
        let turned = 2.0 * guess.velocity.angular_rad_s / self.speed_of_sound_m_s;
        self.pairs.clear();
        for (index, track) in self.tracks.iter_mut().enumerate().filter(|(_, track)| track.sensor == sensor) {
            track.matched = None;
            let ahead_m = track.place_m() + track.velocity_m_s() * guess.interval_s;
            let (range_m, bearing_rad) = polar_from_cartesian(ear.local_from_parent(moved.local_from_parent(ahead_m)));
            let gate_m = if track.age < YOUNG { GATE_YOUNG_M } else { GATE_M };
            for (which, reflector) in reflectors.iter().enumerate() {
                let off = [
                    (reflector.range_m - range_m) / gate_m,
                    wrap_angle_rad(reflector.bearing_rad + turned * reflector.range_m - bearing_rad) / GATE_RAD,
                    f64::from(reflector.energy / track.last.energy).ln() / GATE_ENERGY,
                ];
                let squared: f64 = off.iter().map(|part| part * part).sum();
                if squared < 1.0 && self.pairs.len() < self.pairs.capacity() {
                    self.pairs.push((squared, index, which));
                }
            }
        }
        self.pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
        let mut taken = 0_u64;
        for (_, index, which) in self.pairs.iter().copied() {
            let track = &mut self.tracks[index];
            if track.matched.is_none() && taken >> which & 1 == 0 {
                track.matched = Some(which);
                taken |= 1 << which;
            }
        }
    }

    /// Whether fewer of the reflectors that were found again are known movers than are not: then the others tell the robot's motion.
    #[must_use]
    pub fn movers_are_few(&self) -> bool {
        let found = || self.tracks.iter().filter(|track| track.fresh && track.matched.is_some());
        2 * found().filter(|track| track.is_mover()).count() < found().count()
    }

    /// Enters the rates of the reflectors of a sensor that were heard in the ping set before, too; with or without known movers.
    pub fn rates(
        &self,
        sensor: usize,
        reflectors: &[Reflector],
        (interval_s, with_movers): (f64, bool),
        rates: &mut Vec<ReflectorRate>,
    ) {
        let wanted = |track: &&Track| track.sensor == sensor && track.fresh && (with_movers || !track.is_mover());
        for track in self.tracks.iter().filter(wanted) {
            let Some(reflector) = track.matched.and_then(|which| reflectors.get(which)) else { continue };
            if rates.len() < RATES_MAX {
                rates.push(rate(&self.mounts[sensor], &track.last, reflector, interval_s, track.bend));
            }
        }
    }

    /// Moves all tracks on by what the robot did.
    pub fn advance(&mut self, step: &Step) {
        let (moved, dt_s) = (step.pose(), step.interval_s);
        let turn = Rotation2::new(-moved.heading_rad);
        let mut transition = Matrix4::zeros();
        transition.fixed_view_mut::<2, 2>(0, 0).copy_from(turn.matrix());
        transition.fixed_view_mut::<2, 2>(0, 2).copy_from(&(turn.matrix() * dt_s));
        transition.fixed_view_mut::<2, 2>(2, 2).copy_from(turn.matrix());
        let accel = (ACCEL_M_S2 * dt_s).powi(2);
        for track in &mut self.tracks {
            let place_m = moved.local_from_parent(track.place_m() + track.velocity_m_s() * dt_s);
            let velocity_m_s = turn * track.velocity_m_s();
            track.state = Vector4::new(place_m.x, place_m.y, velocity_m_s.x, velocity_m_s.y);
            let own = dt_s * dt_s * (step.covariance.m11 + step.covariance.m22 * place_m.norm_squared());
            let noise = Matrix4::from_diagonal(&Vector4::new(
                0.25 * accel * dt_s * dt_s + own,
                0.25 * accel * dt_s * dt_s + own,
                accel,
                accel,
            ));
            track.covariance = transition * track.covariance * transition.transpose() + noise;
        }
    }

    /// Takes in what a sensor heard; the tracks were matched and advanced. What no track expected begins one.
    pub fn hear(&mut self, sensor: usize, reflectors: &[Reflector], step: &Step, fit: &EgoFit) {
        let Some(mount) = self.mounts.get(sensor).copied() else { return };
        // While the sound flies the robot turns on: the bearing is that of a heading which was not yet at the emission.
        let turned = 2.0 * step.velocity.angular_rad_s / self.speed_of_sound_m_s;
        let mut known = 0_u64;
        for track in self.tracks.iter_mut().filter(|track| track.sensor == sensor) {
            track.age = track.age.saturating_add(1);
            let Some(which) = track.matched.take().filter(|which| *which < reflectors.len()) else {
                (track.fresh, track.misses) = (false, track.misses + 1);
                continue;
            };
            known |= 1 << which;
            let reflector = &reflectors[which];
            if track.fresh {
                let rate = rate(&mount, &track.last, reflector, step.interval_s, track.bend);
                track.bend = learned_bend(&rate, fit);
            }
            correct(track, &mount, &at_emission(reflector, turned));
            let wide = reflector.bearing_sigma_rad > SURE_RAD;
            judge(track, &self.mounts, step.velocity, wide);
            (track.last, track.fresh, track.misses) = (*reflector, true, 0);
        }
        self.tracks.retain(|track| {
            let patience = if track.age < YOUNG { 0 } else { MISSES_MAX };
            track.misses <= patience && track.state.iter().all(|number| number.is_finite())
        });
        for (_, reflector) in reflectors.iter().enumerate().filter(|(which, _)| known >> which & 1 == 0) {
            if self.tracks.len() < TRACKS_MAX {
                self.tracks.push(begun(self.next_id, sensor, &mount, reflector, turned));
                self.next_id = self.next_id.wrapping_add(1).max(1);
            }
        }
    }

    /// Says of a sensor that nothing was heard from it: its tracks wait.
    pub fn skip(&mut self, sensor: usize) {
        for track in self.tracks.iter_mut().filter(|track| track.sensor == sensor) {
            (track.fresh, track.misses, track.matched) = (false, track.misses + 1, None);
        }
        self.tracks.retain(|track| track.misses <= MISSES_MAX);
    }

    /// What moves, each once, and when a robot of this radius and velocity would touch it.
    #[must_use]
    pub fn movers(&self, radius_m: f64, velocity: Velocity) -> Movers {
        let mut movers = Movers::default();
        for (index, track) in self.tracks.iter().enumerate().filter(|(_, track)| track.is_mover()) {
            let better = |other: &Track| (other.age, track.id) > (track.age, other.id);
            let doubled = self.tracks.iter().enumerate().any(|(other_index, other)| {
                other_index != index
                    && other.is_mover()
                    && (other.place_m() - track.place_m()).norm() < SAME_M
                    && (other.velocity_m_s() - track.velocity_m_s()).norm() < 0.5
                    && better(other)
            });
            if !doubled {
                movers.enter(self.mover(track, radius_m, velocity));
            }
        }
        movers
    }

    fn mover(&self, track: &Track, radius_m: f64, velocity: Velocity) -> Mover {
        let mount = &self.mounts[track.sensor];
        let (ahead, left, range_m) = line_of_sight(mount, track.place_m());
        // The bearing is that of its middle, which is RADIUS_M behind the echo and moves across by as much more.
        let sensor_m_s = ground_velocity_m_s(mount, velocity).dot(&left);
        let across_m_s = (track.velocity_m_s().dot(&left) - sensor_m_s) * (range_m + RADIUS_M) / range_m + sensor_m_s;
        let velocity_m_s = track.velocity_m_s().dot(&ahead) * ahead + across_m_s * left;
        let position_m = track.place_m() + RADIUS_M * ahead;
        let relative_m_s = velocity_m_s - Vector2::new(velocity.linear_m_s, 0.0);
        Mover {
            id: track.id,
            position_m,
            velocity_m_s,
            position_covariance_m2: track.covariance.fixed_view::<2, 2>(0, 0).into(),
            velocity_covariance_m2_s2: track.covariance.fixed_view::<2, 2>(2, 2).into(),
            radius_m: RADIUS_M,
            time_to_contact_s: time_to_contact_s(position_m, relative_m_s, radius_m + RADIUS_M),
            age: track.age,
        }
    }
}

/// When two discs touch whose middles are `position_m` apart and come together at `relative_m_s`; infinite if never.
#[must_use]
pub fn time_to_contact_s(position_m: Vector2<f64>, relative_m_s: Vector2<f64>, reach_m: f64) -> f64 {
    let gap_m2 = position_m.norm_squared() - reach_m * reach_m;
    if gap_m2 <= 0.0 {
        return 0.0;
    }
    let (speed2, closing) = (relative_m_s.norm_squared(), -position_m.dot(&relative_m_s));
    let root = closing * closing - speed2 * gap_m2;
    if closing > 0.0 && root >= 0.0 { gap_m2 / (closing + root.sqrt()) } else { f64::INFINITY }
}

fn rate(mount: &Mount, before: &Reflector, now: &Reflector, interval_s: f64, bend: [f64; 2]) -> ReflectorRate {
    let turned_rad = wrap_angle_rad(now.bearing_rad - before.bearing_rad);
    ReflectorRate {
        mount: *mount,
        range_m: 0.5 * (before.range_m + now.range_m),
        bearing_rad: before.bearing_rad + 0.5 * turned_rad,
        range_rate_m_s: (now.range_m - before.range_m) / interval_s,
        bearing_rate_rad_s: turned_rad / interval_s,
        range_rate_sigma_m_s: before.range_sigma_m.hypot(now.range_sigma_m) / interval_s,
        bearing_rate_sigma_rad_s: before.bearing_sigma_rad.hypot(now.bearing_sigma_rad) / interval_s,
        bearing_sigma_rad: before.bearing_sigma_rad.max(now.bearing_sigma_rad),
        bend,
    }
}

/// What a rate of the bearing tells of kappa, the robot's motion being known.
fn learned_bend(rate: &ReflectorRate, fit: &EgoFit) -> [f64; 2] {
    let [_, turning_rad_s, across_m_s] = expected(&rate.mount, fit.velocity, rate.bearing_rad);
    let [mean, sigma] = rate.bend;
    let sigma = (sigma * BEND_FORGOTTEN).min(unknown_bend(rate.range_m)[1]);
    let noise = rate.bearing_rate_sigma_rad_s.powi(2) + fit.covariance.m22 + 0.02_f64.powi(2);
    let off = rate.bearing_rate_rad_s - turning_rad_s - mean * across_m_s;
    let spread = (across_m_s * sigma).powi(2) + noise;
    if !(off * off < 9.0 * spread) {
        return [mean, sigma];
    }
    let gain = sigma * sigma * across_m_s / spread;
    let least = BEND_SHARE_MIN / rate.range_m;
    [(mean + gain * off).clamp(0.0, 1.0 / rate.range_m), (sigma * (1.0 - gain * across_m_s).max(0.0).sqrt()).max(least)]
}

/// Unit vectors along and across (to the left of) the line from a sensor to a place of the robot frame, and the range.
fn line_of_sight(mount: &Mount, place_m: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>, f64) {
    let offset_m = place_m - mount.position_m();
    let range_m = offset_m.norm().max(1e-3);
    let ahead = offset_m / range_m;
    (ahead, Vector2::new(-ahead.y, ahead.x), range_m)
}

/// Velocity of a sensor over ground, along the axes of the robot frame.
fn ground_velocity_m_s(mount: &Mount, velocity: Velocity) -> Vector2<f64> {
    let place_m = mount.position_m();
    Vector2::new(velocity.linear_m_s - velocity.angular_rad_s * place_m.y, velocity.angular_rad_s * place_m.x)
}

/// The reflector with the bearing that it had when the sound went out; `turned` is the turn of the robot per metre of range.
fn at_emission(reflector: &Reflector, turned: f64) -> Reflector {
    Reflector { bearing_rad: reflector.bearing_rad + turned * reflector.range_m, ..*reflector }
}

/// Place and its covariance of a reflector, in the robot frame.
fn placed(mount: &Mount, reflector: &Reflector) -> (Vector2<f64>, Matrix2<f64>) {
    let place_m = mount.pose().parent_from_local(cartesian_from_polar(reflector.range_m, reflector.bearing_rad));
    let (ahead, left, range_m) = line_of_sight(mount, place_m);
    let along_m2 = reflector.range_sigma_m.powi(2) + WANDER_M * WANDER_M;
    let across_m2 = (range_m * reflector.bearing_sigma_rad.hypot(WANDER_RAD)).powi(2);
    (place_m, along_m2 * ahead * ahead.transpose() + across_m2 * left * left.transpose())
}

fn begun(id: u32, sensor: usize, mount: &Mount, reflector: &Reflector, turned: f64) -> Track {
    let (place_m, spread_m2) = placed(mount, &at_emission(reflector, turned));
    let mut covariance = Matrix4::from_diagonal_element(START_SIGMA_M_S * START_SIGMA_M_S);
    covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(&spread_m2);
    Track {
        id,
        sensor,
        state: Vector4::new(place_m.x, place_m.y, 0.0, 0.0),
        covariance,
        last: *reflector,
        fresh: true,
        bend: unknown_bend(reflector.range_m),
        age: 1,
        misses: 0,
        moving: 0,
        unrest: 2.0,
        matched: None,
    }
}

/// Kalman update with a place.
fn correct(track: &mut Track, mount: &Mount, reflector: &Reflector) {
    let (place_m, spread_m2) = placed(mount, reflector);
    let see = Matrix2x4::identity();
    let off_m = place_m - track.place_m();
    let innovation: Matrix2<f64> = see * track.covariance * see.transpose() + spread_m2;
    let Some(inverse) = innovation.try_inverse() else { return };
    let gain = track.covariance * see.transpose() * inverse;
    track.state += gain * off_m;
    let rest = Matrix4::identity() - gain * see;
    track.covariance = rest * track.covariance * rest.transpose() + gain * spread_m2 * gain.transpose();
    track.unrest += 0.2 * (off_m.dot(&(inverse * off_m)) - track.unrest);
}

/// What is left of a speed that something at rest may have up to these limits, 0 among them.
fn beyond_m_s(speed_m_s: f64, limits_m_s: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = limits_m_s.fold((0.0_f64, 0.0_f64), |(low, high), limit| (low.min(limit), high.max(limit)));
    speed_m_s - speed_m_s.clamp(low, high)
}

/// Whether a track's velocity contradicts everything that an echo of something at rest can do. `mounts` are those of all sensors: one
/// may hear what another sent, and then half of the way is that one's, whose own motion in a turn is another. A bearing that is not sure
/// (`wide`) contradicts nothing.
fn judge(track: &mut Track, mounts: &[Mount], velocity: Velocity, wide: bool) {
    let mount = &mounts[track.sensor];
    let (ahead, left, _) = line_of_sight(mount, track.place_m());
    let own_m_s = ground_velocity_m_s(mount, velocity);
    let others_m_s = || mounts.iter().map(|other| ground_velocity_m_s(other, velocity));
    let along_m_s =
        beyond_m_s(track.velocity_m_s().dot(&ahead), others_m_s().map(|other| 0.5 * (own_m_s - other).dot(&ahead)));
    let across_m_s = beyond_m_s(track.velocity_m_s().dot(&left), others_m_s().map(|other| other.dot(&left)));
    let across_m_s = if wide { 0.0 } else { across_m_s };
    let spread: Matrix2<f64> = track.covariance.fixed_view::<2, 2>(2, 2).into();
    let variance = |axis: &Vector2<f64>| axis.dot(&(spread * axis));
    let squared = along_m_s.powi(2) / (variance(&ahead) + RADIAL_SIGMA_M_S.powi(2))
        + across_m_s.powi(2) / (variance(&left) + LATERAL_SIGMA_M_S.powi(2));
    let moves = squared > CONTRADICTION && along_m_s.hypot(across_m_s) > SPEED_MIN_M_S;
    track.moving = if moves { (track.moving + 1).min(MOVING_MAX) } else { track.moving.saturating_sub(1) };
}
