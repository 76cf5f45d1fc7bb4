//! The corridor law of AFF: to the middle between two walls (paper 000, eq. 16, with signed distances and damping).
//!
//! Goes in: signed lateral distances of the walls on either side (left positive), of one of them while the other is not heard,
//! and what was driven. Comes out: lambda e + lambda_d de/dt with e = d_l + d_r, bounded so that the robot does not turn
//! farther askew than flow lines hear both walls: a specular wall answers from where it is square to the sensor, d sin(skew) ahead of
//! abeam or behind it, and a wall heard on one side only says nothing of the middle. Knows no thresholds and no walls to choose from.

use crate::signal::Velocity;

/// Damping ratio.
const DAMPING_RATIO: f64 = 0.7;
/// Speed below which the damping does not grow any more.
const DAMPING_SPEED_MIN_M_S: f64 = 0.1;
/// A wall whose distance changes between two activations by this much more than the robot can have moved is another wall.
pub(super) const SAME_WALL_M: f64 = 0.1;
/// Share of the stretch of a flow line that skew may use up: what is left is for the error of the skew and the echo's own width.
const STRETCH_SHARE: f64 = 0.8;
/// Steepest way to the middle, as a sine: 20 deg; and 6 deg, however far the walls and short the flow lines.
const SKEW_MAX: f64 = 0.35;
const SKEW_MIN: f64 = 0.1;
/// Time in which the robot turns to the greatest skew, from along the walls: longer than from a ping to the turn that it asks for.
const SKEW_TURN_S: f64 = 0.5;
/// Least share of a new skew in the estimate: lateral distances err by a centimetre, the way between two ping sets is 3 cm.
const SKEW_SHARE_MIN: f64 = 0.1;
/// Shortest way that a skew is taken from.
const WAY_MIN_M: f64 = 0.01;
/// Way for which the width is remembered after both walls were heard last: about what it takes to get to the middle.
const KEPT_M: f64 = 3.0;
/// A wanted turn that is faster says more than a wall that is not heard: it may lead out of the corridor.
const ASKED_MAX_RAD_S: f64 = 0.1;

/// The law's memory.
#[derive(Debug, Clone)]
pub(super) struct CorridorLaw {
    lambda: f64,
    filter_s: f64,
    /// How far ahead and behind flow lines reach.
    abeam_m: f64,
    previous_offset_m: Option<f64>,
    offset_rate_m_s: f64,
    /// Heading against the walls, left positive, and how many times it was measured.
    skew_rad: f64,
    skew_count: u32,
    /// The walls when the law was asked last, and the way since both were heard.
    walls_m: Option<[f64; 2]>,
    alone_m: f64,
    /// Since the law was asked last.
    elapsed_s: f64,
    way_m: f64,
}

impl CorridorLaw {
    pub(super) fn new(lambda: f64, filter_s: f64, abeam_m: f64) -> Self {
        Self {
            lambda,
            filter_s,
            abeam_m,
            previous_offset_m: None,
            offset_rate_m_s: 0.0,
            skew_rad: 0.0,
            skew_count: 0,
            walls_m: None,
            alone_m: 0.0,
            elapsed_s: 0.0,
            way_m: 0.0,
        }
    }

    /// Forgets everything but the gains.
    pub(super) fn forget(&mut self) {
        *self = Self::new(self.lambda, self.filter_s, self.abeam_m);
    }

    /// Takes note of what was driven since the last ping set.
    pub(super) fn advance(&mut self, driven: Velocity, elapsed_s: f64) {
        self.elapsed_s += elapsed_s;
        self.way_m += driven.linear_m_s * elapsed_s;
        self.alone_m += driven.linear_m_s.abs() * elapsed_s;
        self.skew_rad += driven.angular_rad_s * elapsed_s;
    }

    /// Both walls of the corridor that was followed lately, from the one that is heard: its distance, and that of the other by the
    /// corridor's width. `None` when it is another wall, a turn is wanted or the corridor was left too long ago.
    pub(super) fn completed_m(&self, heard_m: f64, wanted: Velocity) -> Option<[f64; 2]> {
        let is_kept = self.alone_m <= KEPT_M && wanted.angular_rad_s.abs() <= ASKED_MAX_RAD_S;
        let [left_m, right_m] = self.walls_m.filter(|_| is_kept)?;
        let before_m = if heard_m > 0.0 { left_m } else { right_m };
        let same = (heard_m - before_m).abs() <= SAME_WALL_M + wanted.linear_m_s.abs() * self.elapsed_s;
        let width_m = left_m - right_m;
        let walls_m = if heard_m > 0.0 { [heard_m, heard_m - width_m] } else { [heard_m + width_m, heard_m] };
        same.then_some(walls_m)
    }

    /// The turn rate between two walls; `heard` when both of them are.
    pub(super) fn rate_rad_s(&mut self, [left_m, right_m]: [f64; 2], heard: bool, linear_m_s: f64) -> f64 {
        let offset_m = left_m + right_m;
        // Both walls' distances change by what the robot moves sideways.
        let change_max_m = SAME_WALL_M + 2.0 * linear_m_s.abs() * self.elapsed_s;
        match self.previous_offset_m.filter(|previous_m| (offset_m - previous_m).abs() <= change_max_m) {
            Some(previous_m) if self.elapsed_s > 0.0 => {
                let rate_m_s = (offset_m - previous_m) / self.elapsed_s;
                let share = self.elapsed_s / (self.filter_s + self.elapsed_s);
                self.offset_rate_m_s += share * (rate_m_s - self.offset_rate_m_s);
                self.measure_skew(offset_m - previous_m);
            }
            Some(_) => {}
            None => self.offset_rate_m_s = 0.0,
        }
        self.previous_offset_m = Some(offset_m);
        self.walls_m = Some([left_m, right_m]);
        self.alone_m = if heard { 0.0 } else { self.alone_m };
        (self.elapsed_s, self.way_m) = (0.0, 0.0);
        let speed_m_s = linear_m_s.abs().max(DAMPING_SPEED_MIN_M_S);
        let damping = DAMPING_RATIO * (2.0 * self.lambda / speed_m_s).sqrt();
        let law_rad_s = self.lambda * offset_m + damping * self.offset_rate_m_s;
        self.bounded_rad_s(law_rad_s, left_m.abs().max(right_m.abs()))
    }

    /// Driving ds at a skew changes e by -2 ds sin(skew).
    fn measure_skew(&mut self, change_m: f64) {
        if self.way_m < WAY_MIN_M {
            return;
        }
        let measured_rad = (-0.5 * change_m / self.way_m).clamp(-1.0, 1.0).asin();
        self.skew_count = self.skew_count.saturating_add(1);
        let share = (1.0 / f64::from(self.skew_count + 1)).max(SKEW_SHARE_MIN);
        self.skew_rad += share * (measured_rad - self.skew_rad);
    }

    /// Held to turn rates that end at the greatest skew. A turn back along the walls never is.
    fn bounded_rad_s(&self, law_rad_s: f64, farther_m: f64) -> f64 {
        let skew_max_rad = (STRETCH_SHARE * self.abeam_m / farther_m).clamp(SKEW_MIN, SKEW_MAX).asin();
        let left_rad_s = (skew_max_rad - self.skew_rad).max(0.0) / SKEW_TURN_S;
        let right_rad_s = (skew_max_rad + self.skew_rad).max(0.0) / SKEW_TURN_S;
        law_rad_s.clamp(-right_rad_s, left_rad_s)
    }
}
