//! How a run went: the fields of `simulate --json` that the world knows (specification, section 11).
//!
//! Which layer was active, the layout and the seed are the caller's to add.

use nalgebra::Vector2;
use serde::Serialize;

/// Within this distance of where it was the robot counts as not having moved on.
const PROGRESS_M: f64 = 0.1;

/// Result of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RunScore {
    /// Whether the robot or one of its sensors touched anything.
    pub collided: bool,
    /// Last waypoint reached within the time limit; without waypoints, no contact until the limit.
    pub reached_goal: bool,
    /// Waypoints reached, in order.
    pub waypoints_reached: usize,
    /// Longest time within 0.1 m of one place while motion was wanted.
    pub longest_stuck_s: f64,
    /// Time until contact, the goal or the limit, or so far.
    pub duration_s: f64,
    /// Way driven.
    pub path_length_m: f64,
    /// Smallest gap between the footprint and anything; at most 100 m.
    pub min_clearance_m: f64,
    /// Way over time.
    pub mean_speed_m_s: f64,
}

/// Whether a gap is one; NaN is none.
pub(super) fn is_clear(clearance_m: f64) -> bool {
    clearance_m > 0.0
}

/// The longest time that a robot stayed within 0.1 m of one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stay {
    anchor_m: Vector2<f64>,
    since_s: f64,
    longest_s: f64,
}

impl Stay {
    /// A robot at `place_m`, at time 0.
    #[must_use]
    pub fn new(place_m: Vector2<f64>) -> Self {
        Self { anchor_m: place_m, since_s: 0.0, longest_s: 0.0 }
    }

    /// Notes where the robot is; unless it `counts`, it is as if the robot had just come there.
    pub fn note(&mut self, time_s: f64, place_m: Vector2<f64>, counts: bool) {
        if !counts || (place_m - self.anchor_m).norm() > PROGRESS_M {
            (self.anchor_m, self.since_s) = (place_m, time_s);
        }
        self.longest_s = self.longest_s.max(time_s - self.since_s);
    }

    /// The longest so far.
    #[must_use]
    pub fn longest_s(&self) -> f64 {
        self.longest_s
    }
}

/// What is kept while a run goes on.
#[derive(Debug, Clone)]
pub(super) struct Scorer {
    pub(super) score: RunScore,
    pub(super) finished: bool,
    place_m: Vector2<f64>,
    stay: Stay,
}

impl Scorer {
    pub(super) fn new(place_m: Vector2<f64>, clearance_m: f64) -> Self {
        let score = RunScore {
            collided: false,
            reached_goal: false,
            waypoints_reached: 0,
            longest_stuck_s: 0.0,
            duration_s: 0.0,
            path_length_m: 0.0,
            min_clearance_m: clearance_m,
            mean_speed_m_s: 0.0,
        };
        Self { score, finished: false, place_m, stay: Stay::new(place_m) }
    }

    /// Notes where the robot is now. `waypoints` is how many are reached and how many there are.
    pub(super) fn note(
        &mut self,
        time_s: f64,
        place_m: Vector2<f64>,
        clearance_m: f64,
        motion_wanted: bool,
        waypoints: (usize, usize),
        time_limit_s: f64,
    ) {
        if self.finished {
            return;
        }
        let score = &mut self.score;
        score.path_length_m += (place_m - self.place_m).norm();
        self.place_m = place_m;
        score.duration_s = time_s;
        score.mean_speed_m_s = if time_s > 0.0 { score.path_length_m / time_s } else { 0.0 };
        score.min_clearance_m = score.min_clearance_m.min(clearance_m.max(0.0));
        score.collided |= !is_clear(clearance_m);
        score.waypoints_reached = waypoints.0;
        self.stay.note(time_s, place_m, motion_wanted);
        score.longest_stuck_s = self.stay.longest_s();
        // A step may end a hair beside the limit.
        let in_time = time_s <= time_limit_s + 1e-9;
        let at_limit = time_s >= time_limit_s - 1e-9;
        score.reached_goal = !score.collided
            && match waypoints {
                (_, 0) => at_limit,
                (reached, all) => score.reached_goal || (reached >= all && in_time),
            };
        self.finished = score.collided || score.reached_goal || at_limit;
    }
}
