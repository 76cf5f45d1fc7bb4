//! CA: stop, turn away from the nearest reflection, back off where that is seen to be safe (paper 000, eq. 11, with |M|).
//!
//! Goes in: the cue of the CA region. Comes out: V = 0 and a constant turn rate, its side held until the region is clear; from
//! the fourth ping set in a row that is above the threshold a slow reverse, within a budget of way and time. What comes so
//! near that it is not heard any more counts as being there until the robot has turned away from it. Never drives forward.

use super::default_regions::DEAF_RANGE_M;
use super::layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation, is_above, region_cause};
use super::params::CollisionAvoidanceParams;
use crate::signal::{LayerName, Velocity};

/// Nearer by no more than this, with a turn asked for, counts as equally near: c / (2 bandwidth) is 7 mm, and the axis errs a little.
const RANGE_RESOLUTION_M: f64 = 0.01;

/// Way behind the footprint that must be seen and free for the next piece of reverse, besides that piece.
const REVERSE_MARGIN_M: f64 = 0.1;

/// How much farther than the deaf range what falls silent may have been heard last: a walker's way between two ping sets.
const HIDING_M: f64 = 0.15;
/// Turn after which the way straight on passes what is hidden: 60 deg, at half a metre from centre to centre.
const HIDDEN_TURN_RAD: f64 = 1.05;

/// Periods that a command may live before the next one or the age limit ends it: what the reverse budget must have left.
const PERIODS_HELD_MAX: f64 = 3.0;

/// The layer and its memory.
#[derive(Debug, Clone)]
pub struct CollisionAvoidance {
    params: CollisionAvoidanceParams,
    period_s: f64,
    switch: Hysteresis,
    /// Ping sets in a row whose energy held the layer.
    run: u32,
    /// +1 turning left, -1 right; held while the layer is on.
    held_turn: Option<f64>,
    last_turn: Option<f64>,
    /// Range at which the nearest reflection of the CA region was heard last.
    last_range_m: f64,
    /// Whether silence would mean that it is too near to be heard.
    hides: bool,
    /// Turned since then.
    turned_unheard_rad: f64,
    /// Spent since the region was clear.
    reversed_m: f64,
    reversed_s: f64,
    reversing: bool,
}

impl CollisionAvoidance {
    /// The layer, idle. `period_s` is the time between ping sets.
    #[must_use]
    pub fn new(params: &CollisionAvoidanceParams, period_s: f64) -> Self {
        Self {
            params: params.clone(),
            period_s,
            switch: Hysteresis::new(params.trigger_count, params.release_count),
            run: 0,
            held_turn: None,
            last_turn: None,
            last_range_m: 0.0,
            hides: false,
            turned_unheard_rad: 0.0,
            reversed_m: 0.0,
            reversed_s: 0.0,
            reversing: false,
        }
    }

    /// +1 to turn left, -1 right: away from the nearest reflection; with none, or left and right equally near, the way that
    /// the wanted velocity turns, else the way turned last, else left.
    fn choose_turn(&self, situation: &Situation) -> f64 {
        let asked_rad_s = situation.asked_rad_s;
        let asked = (asked_rad_s != 0.0).then(|| asked_rad_s.signum());
        match situation.cues.collision.nearest.filter(|nearest| nearest.side != 0) {
            // A wall ahead need not be square to be as near on the left as on the right.
            Some(nearest) if asked.is_none() || !(nearest.lead_m <= RANGE_RESOLUTION_M) => {
                -f64::from(nearest.side.signum())
            }
            // The detour holds back a turn to what was avoided a moment ago; there is no better reason for a side.
            Some(_) if situation.wanted.angular_rad_s == 0.0 => -asked_rad_s.signum(),
            _ => asked.or(self.last_turn).unwrap_or(1.0),
        }
    }

    /// Whether something that came nearer of itself fell silent because it is now nearer than any sensor hears; it counts as being
    /// there until the robot has turned away from it.
    fn hides_too_near(&mut self, situation: &Situation, heard: bool) -> bool {
        if heard {
            if let Some(nearest) = situation.cues.collision.nearest {
                self.last_range_m = nearest.range_m;
            }
            self.turned_unheard_rad = 0.0;
            // Kept as it was when the last echo was heard: silence is no departure.
            self.hides = situation.approaching && self.last_range_m <= DEAF_RANGE_M + HIDING_M;
            return false;
        }
        self.turned_unheard_rad += situation.last.angular_rad_s.abs() * situation.elapsed_s;
        self.switch.is_on() && self.hides && self.turned_unheard_rad < HIDDEN_TURN_RAD
    }

    /// Whether one more command to reverse stays within the budget and within what is seen behind, however long it lives.
    fn may_reverse(&self, behind_m: f64) -> bool {
        let held_s = PERIODS_HELD_MAX * self.period_s;
        let held_m = self.params.reverse_m_s * held_s;
        self.run >= self.params.reverse_after
            && self.reversed_m + held_m <= self.params.reverse_max_m + 1e-9
            && self.reversed_s + held_s <= self.params.reverse_max_s + 1e-9
            && behind_m >= held_m + REVERSE_MARGIN_M
    }
}

impl BehaviourLayer for CollisionAvoidance {
    fn name(&self) -> LayerName {
        LayerName::CollisionAvoidance
    }

    fn observe(&mut self, situation: &Situation) -> bool {
        if self.reversing {
            // A period was charged when it was commanded; a late ping set made it longer.
            let overtime_s = (situation.elapsed_s - self.period_s).max(0.0);
            self.reversed_m += self.params.reverse_m_s * overtime_s;
            self.reversed_s += overtime_s;
            self.reversing = false;
        }
        let energy = f64::from(situation.cues.collision.energy);
        let heard = is_above(energy, self.params.release);
        let holds = self.hides_too_near(situation, heard) || heard;
        let was_on = self.switch.is_on();
        let on = self.switch.update(is_above(energy, self.params.threshold), holds);
        self.run = if on && holds { self.run.saturating_add(1) } else { 0 };
        if on && !was_on {
            self.held_turn = Some(self.choose_turn(situation));
            self.last_turn = self.held_turn;
        } else if !on {
            self.held_turn = None;
        }
        if !on && !holds {
            (self.reversed_m, self.reversed_s) = (0.0, 0.0);
        }
        on
    }

    fn act(&mut self, situation: &Situation) -> LayerOutput {
        let cue = &situation.cues.collision;
        self.reversing = self.may_reverse(situation.cues.coverage.behind_m);
        if self.reversing {
            self.reversed_m += self.params.reverse_m_s * self.period_s;
            self.reversed_s += self.period_s;
        }
        let turn = self.held_turn.unwrap_or(1.0);
        LayerOutput {
            velocity: Velocity {
                linear_m_s: if self.reversing { -self.params.reverse_m_s } else { 0.0 },
                angular_rad_s: turn * self.params.omega_rad_s,
            },
            cause: region_cause(cue, cue.energy, self.params.threshold),
        }
    }

    fn stand_by(&mut self) {}

    fn reset(&mut self) {
        // A budget of way and time is not earned anew by forgetting what it was spent on: only a clear region gives it back.
        let (reversed_m, reversed_s) = (self.reversed_m, self.reversed_s);
        *self = Self { reversed_m, reversed_s, ..Self::new(&self.params, self.period_s) };
    }
}
