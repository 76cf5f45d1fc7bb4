//! What a behaviour layer is: it observes every ping set, and acts when it is triggered and no layer above it is.
//!
//! Also the switch with two thresholds and two counts that every layer is triggered by. Knows no law.

use crate::signal::{Cause, Cues, LayerCue, LayerName, Velocity};

/// What a layer is told of one ping set.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a> {
    /// What the sensors hear.
    pub cues: &'a Cues,
    /// The wanted velocity (V_i, omega_i), finite and within the platform's limits, without turns back to what was avoided.
    pub wanted: Velocity,
    /// Whether the nearest reflection came nearer of itself lately.
    pub approaching: bool,
    /// omega_i as it was asked for.
    pub asked_rad_s: f64,
    /// The velocity commanded last.
    pub last: Velocity,
    /// Time since then.
    pub elapsed_s: f64,
}

/// Wanted speed, and radius of the wanted turn, below which the robot only turns.
const DRIVING_MIN_M_S: f64 = 0.01;
const TURN_RADIUS_MIN_M: f64 = 0.1;

impl Situation<'_> {
    /// Whether driving is wanted, not only a turn on the spot. Such a turn runs into nothing, and steering against it would
    /// hold a robot for ever that turns to get away; the layers that bend a way leave it as it was wanted.
    #[must_use]
    pub fn is_driving(&self) -> bool {
        is_driving(self.wanted)
    }
}

/// Whether a velocity drives somewhere, not only turns on the spot.
#[must_use]
pub(super) fn is_driving(wanted: Velocity) -> bool {
    let speed_m_s = wanted.linear_m_s.abs();
    speed_m_s >= DRIVING_MIN_M_S && speed_m_s >= TURN_RADIUS_MIN_M * wanted.angular_rad_s.abs()
}

/// What a layer wants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayerOutput {
    /// The velocity, before the limits of the platform and of what is seen.
    pub velocity: Velocity,
    /// The reflection behind it.
    pub cause: Cause,
}

/// A behaviour layer. Each ping set [`BehaviourLayer::observe`] is called once on every layer, then
/// [`BehaviourLayer::act`] on the highest that is triggered and [`BehaviourLayer::stand_by`] on all others.
pub trait BehaviourLayer: std::fmt::Debug + Send {
    /// Which layer this is.
    fn name(&self) -> LayerName;

    /// Takes note of a ping set; true when the layer is triggered.
    fn observe(&mut self, situation: &Situation) -> bool;

    /// The law of the layer; called only while it is triggered.
    fn act(&mut self, situation: &Situation) -> LayerOutput;

    /// Another layer acts, or none does: forgets what only holds while this one acts without a break.
    fn stand_by(&mut self);

    /// Forgets everything.
    fn reset(&mut self);
}

/// A switch with separate thresholds and counts for going on and off.
#[derive(Debug, Clone)]
pub struct Hysteresis {
    trigger_count: u32,
    release_count: u32,
    on: bool,
    /// Ping sets in a row that speak for changing over.
    run: u32,
}

impl Hysteresis {
    /// A switch that is off. It goes on after `trigger_count` ping sets in a row that fire, off after `release_count` that
    /// do not hold.
    #[must_use]
    pub fn new(trigger_count: u32, release_count: u32) -> Self {
        Self { trigger_count, release_count, on: false, run: 0 }
    }

    /// Takes one ping set: `fires`, above the trigger threshold; `holds`, above the release threshold. What fires holds.
    pub fn update(&mut self, fires: bool, holds: bool) -> bool {
        let (speaks, needed) =
            if self.on { (!(holds || fires), self.release_count) } else { (fires, self.trigger_count) };
        self.run = if speaks { self.run.saturating_add(1) } else { 0 };
        if self.run >= needed && speaks {
            self.on = !self.on;
            self.run = 0;
        }
        self.on
    }

    /// Whether it is on.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Switches off.
    pub fn reset(&mut self) {
        (self.on, self.run) = (false, 0);
    }
}

/// Whether an energy is above a threshold. NaN is.
#[must_use]
pub fn is_above(energy: f64, threshold: f64) -> bool {
    !(energy <= threshold)
}

/// The cause that a region's nearest reflection gives; `energy` is what was compared with `threshold`.
#[must_use]
pub fn region_cause(cue: &LayerCue, energy: f32, threshold: f64) -> Cause {
    let energy = f64::from(energy);
    match cue.nearest {
        Some(nearest) => Cause {
            sensor_index: Some(nearest.sensor_index),
            range_m: nearest.range_m,
            bearing_rad: nearest.bearing_rad,
            energy,
            threshold,
        },
        None => Cause { energy, threshold, ..Cause::default() },
    }
}

/// Turn rate away from the louder side, gain * sum(E M / r^2) / sum(E|M|), positive where the left is louder (eq. 12 and
/// 13, with |M| below the line). Zero where there is nothing to divide by, or nothing finite.
#[must_use]
pub fn balance_rad_s(cue: &LayerCue, gain: f64) -> f64 {
    let (turn, energy) = (f64::from(cue.turn), f64::from(cue.energy));
    let rate_rad_s = gain * turn / energy;
    if energy > 0.0 && energy.is_finite() && rate_rad_s.is_finite() { rate_rad_s } else { 0.0 }
}
