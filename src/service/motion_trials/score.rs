//! The score of a drive: errors of V and omega, honesty of the covariance, slips told and made up, movers found and made up.
//!
//! Goes in: [`super::MotionSample`]s and the times in which the wheels slipped. Comes out: sums that can be added up over drives. Judges
//! only; nothing here is known to the estimator.

use super::MotionSample;
use crate::detect::ego_tracks::time_to_contact_s;
use crate::service::trial::Slip;
use crate::signal::{Mover, Velocity};
use crate::sim::MoverTruth;
use nalgebra::{Rotation2, Vector2};

/// A mover is to be heard if its middle is within this range of the robot and it moves at least so fast.
const HEARD_WITHIN_M: f64 = 3.0;
const MOVES_MIN_M_S: f64 = 0.15;
/// And has been so for so long.
const HEARD_FOR: usize = 6;
/// A mover told within this distance of a real one is that one.
const SAME_M: f64 = 0.6;
/// How much wheels and body must differ to call it a slip.
const SLIP_M_S: f64 = 0.08;
const SLIP_RAD_S: f64 = 0.2;
/// How long after the beginning of a slip an alarm counts as its own, beyond its end.
const AFTER_S: f64 = 0.7;
/// Times to contact are compared up to here.
const CONTACT_MAX_S: f64 = 6.0;

/// Sums over ping sets; add them up with [`MotionScore::add`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionScore {
    /// Drives.
    pub drives: usize,
    /// Ping sets.
    pub sets: usize,
    /// Ping sets in which V was observed, and omega.
    pub observed: [usize; 2],
    /// Sum of the squared errors of V and omega where observed.
    pub squares: [f64; 2],
    /// The same of odometry, in the same ping sets.
    pub wheel_squares: [f64; 2],
    /// Ping sets in which both were observed, and the sum of their squared error over the covariance.
    pub nees_sets: usize,
    /// See above.
    pub nees: f64,
    /// Slips that were there, those told, and the sum of the delays of the latter.
    pub slips: usize,
    /// See above.
    pub slips_told: usize,
    /// See above.
    pub slip_delay_s: f64,
    /// Alarms outside slips.
    pub false_alarms: usize,
    /// Ping sets in which a mover was to be heard, and in which it was told, a mover at a time.
    pub mover_sets: usize,
    /// See above.
    pub mover_hits: usize,
    /// Movers that were to be heard at some time, and those told at some time while they were.
    pub movers: usize,
    /// See above.
    pub movers_found: usize,
    /// Tracks told that are no mover.
    pub ghosts: usize,
    /// Ping sets in which one was told.
    pub ghost_sets: usize,
    /// Sum of the squared errors of a mover's speed along each axis, and of its place.
    pub mover_squares: [f64; 2],
    /// Times to contact told of movers that would touch the robot, the sum of their errors' magnitudes.
    pub contacts: usize,
    /// See above.
    pub contact_error_s: f64,
    /// Time driven.
    pub time_s: f64,
}

impl MotionScore {
    /// Adds another's sums.
    pub fn add(&mut self, other: &Self) {
        for axis in 0..2 {
            self.observed[axis] += other.observed[axis];
            self.squares[axis] += other.squares[axis];
            self.wheel_squares[axis] += other.wheel_squares[axis];
            self.mover_squares[axis] += other.mover_squares[axis];
        }
        self.drives += other.drives;
        self.sets += other.sets;
        self.nees_sets += other.nees_sets;
        self.nees += other.nees;
        self.slips += other.slips;
        self.slips_told += other.slips_told;
        self.slip_delay_s += other.slip_delay_s;
        self.false_alarms += other.false_alarms;
        self.mover_sets += other.mover_sets;
        self.mover_hits += other.mover_hits;
        self.movers += other.movers;
        self.movers_found += other.movers_found;
        self.ghosts += other.ghosts;
        self.ghost_sets += other.ghost_sets;
        self.contacts += other.contacts;
        self.contact_error_s += other.contact_error_s;
        self.time_s += other.time_s;
    }

    /// Root mean square error of V and omega where observed; `None` where nothing was.
    #[must_use]
    pub fn rms(&self) -> [Option<f64>; 2] {
        std::array::from_fn(|axis| root_mean(self.squares[axis], self.observed[axis]))
    }

    /// The same of odometry.
    #[must_use]
    pub fn wheel_rms(&self) -> [Option<f64>; 2] {
        std::array::from_fn(|axis| root_mean(self.wheel_squares[axis], self.observed[axis]))
    }

    /// Mean squared error over covariance, 2 if that is honest.
    #[must_use]
    pub fn mean_nees(&self) -> Option<f64> {
        (self.nees_sets > 0).then(|| self.nees / self.nees_sets as f64)
    }

    /// Root mean square error of a mover's velocity along an axis, and of its place along an axis.
    #[must_use]
    pub fn mover_rms(&self) -> [Option<f64>; 2] {
        self.mover_squares.map(|squares| root_mean(squares, 2 * self.mover_hits))
    }

    /// So many an hour.
    #[must_use]
    pub fn per_hour(&self, count: usize) -> f64 {
        count as f64 * 3600.0 / self.time_s.max(1e-9)
    }
}

fn root_mean(squares: f64, count: usize) -> Option<f64> {
    (count > 0).then(|| (squares / count as f64).sqrt())
}

/// Scores one drive of a robot of this radius.
#[must_use]
pub fn score(samples: &[MotionSample], slips: &[Slip], radius_m: f64) -> MotionScore {
    let mut score = MotionScore { drives: 1, sets: samples.len(), ..MotionScore::default() };
    score.time_s = samples.iter().map(|sample| sample.report.interval_s).sum();
    samples.iter().for_each(|sample| score_motion(&mut score, sample));
    score_slips(&mut score, samples, slips);
    score_movers(&mut score, samples, radius_m);
    score
}

fn pair(velocity: Velocity) -> Vector2<f64> {
    Vector2::new(velocity.linear_m_s, velocity.angular_rad_s)
}

fn score_motion(score: &mut MotionScore, sample: &MotionSample) {
    let report = &sample.report;
    let off = pair(report.velocity) - pair(sample.truth);
    let wheels = report.odometry.map_or(Vector2::zeros(), |wheels| pair(wheels) - pair(sample.truth));
    for axis in 0..2 {
        if report.observed[axis] {
            score.observed[axis] += 1;
            score.squares[axis] += off[axis].powi(2);
            score.wheel_squares[axis] += wheels[axis].powi(2);
        }
    }
    if report.observed == [true; 2]
        && let Some(inverse) = report.covariance.try_inverse()
    {
        score.nees_sets += 1;
        score.nees += off.dot(&(inverse * off));
    }
}

fn score_slips(score: &mut MotionScore, samples: &[MotionSample], slips: &[Slip]) {
    let differs = |sample: &MotionSample| {
        let wheels = sample.report.odometry.map_or(Vector2::zeros(), |wheels| pair(wheels) - pair(sample.truth));
        wheels.x.abs() > SLIP_M_S || wheels.y.abs() > SLIP_RAD_S
    };
    let owner = |time_s: f64| {
        slips.iter().position(|slip| time_s >= slip.from_to_s[0] && time_s <= slip.from_to_s[1] + AFTER_S)
    };
    for (index, slip) in slips.iter().enumerate() {
        let own = || samples.iter().filter(|sample| owner(sample.time_s) == Some(index));
        let slipping: Vec<f64> = own().filter(|sample| differs(sample)).map(|sample| sample.time_s).collect();
        // Wheels that hardly turn hardly slip.
        if slipping.len() < 5 {
            continue;
        }
        score.slips += 1;
        if let Some(told) = own().find(|sample| sample.report.slip && sample.time_s <= slip.from_to_s[1] + AFTER_S) {
            score.slips_told += 1;
            score.slip_delay_s += (told.time_s - slipping[0]).max(0.0);
        }
    }
    let raised = samples.windows(2).filter(|pair| !pair[0].report.slip && pair[1].report.slip);
    score.false_alarms += raised.filter(|pair| owner(pair[1].time_s).is_none()).count();
}

/// A real mover in the robot's frame.
struct Seen {
    centre_m: Vector2<f64>,
    velocity_m_s: Vector2<f64>,
}

fn seen(sample: &MotionSample, truth: &MoverTruth) -> Seen {
    let turn = Rotation2::new(-sample.pose.heading_rad);
    Seen { centre_m: sample.pose.local_from_parent(truth.centre_m), velocity_m_s: turn * truth.velocity_m_s }
}

fn score_movers(score: &mut MotionScore, samples: &[MotionSample], radius_m: f64) {
    let count = samples.first().map_or(0, |sample| sample.movers.len());
    let (mut due_for, mut due_once, mut found_once) = (vec![0; count], vec![false; count], vec![false; count]);
    let mut ghosts: Vec<u32> = Vec::new();
    for sample in samples {
        let told = sample.report.movers.as_slice();
        for (index, truth) in sample.movers.iter().enumerate() {
            let seen = seen(sample, truth);
            let moves = truth.velocity_m_s.norm() >= MOVES_MIN_M_S;
            let near = seen.centre_m.norm() <= HEARD_WITHIN_M && truth.in_sight;
            due_for[index] = if moves && near { due_for[index] + 1 } else { 0 };
            if due_for[index] < HEARD_FOR {
                continue;
            }
            (score.mover_sets, due_once[index]) = (score.mover_sets + 1, true);
            let off_m = |mover: &&Mover| (mover.position_m - seen.centre_m).norm();
            let nearest = told.iter().min_by(|a, b| off_m(a).total_cmp(&off_m(b))).filter(|m| off_m(m) <= SAME_M);
            if let Some(mover) = nearest {
                found_once[index] = true;
                score_hit(score, sample, mover, (&seen, truth.radius_m + radius_m));
            }
        }
        let is_ghost = |mover: &&Mover| {
            sample.movers.iter().all(|truth| {
                let seen = seen(sample, truth);
                (seen.centre_m - mover.position_m).norm() > SAME_M + truth.radius_m
            })
        };
        let before = ghosts.len();
        let mut any = false;
        for mover in told.iter().filter(is_ghost) {
            any = true;
            if !ghosts.contains(&mover.id) {
                ghosts.push(mover.id);
            }
        }
        score.ghosts += ghosts.len() - before;
        score.ghost_sets += usize::from(any);
    }
    score.movers += due_once.iter().filter(|due| **due).count();
    score.movers_found += found_once.iter().filter(|found| **found).count();
}

fn score_hit(score: &mut MotionScore, sample: &MotionSample, mover: &Mover, (seen, reach_m): (&Seen, f64)) {
    score.mover_hits += 1;
    score.mover_squares[0] += (mover.velocity_m_s - seen.velocity_m_s).norm_squared();
    score.mover_squares[1] += (mover.position_m - seen.centre_m).norm_squared();
    let relative_m_s = seen.velocity_m_s - Vector2::new(sample.truth.linear_m_s, 0.0);
    let truth_s = time_to_contact_s(seen.centre_m, relative_m_s, reach_m);
    if truth_s <= CONTACT_MAX_S && mover.time_to_contact_s <= 2.0 * CONTACT_MAX_S {
        score.contacts += 1;
        score.contact_error_s += (mover.time_to_contact_s - truth_s).abs();
    }
}
