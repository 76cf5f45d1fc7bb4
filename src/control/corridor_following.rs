//! RCF: turn until left and right are equally loud (paper 000, eq. 13, with |M| and guarded quotients).
//!
//! Goes in: the cue of the side regions. Comes out: omega_i - lambda sum(E M / r^2) / sum(E|M|), V = V_i. Leaves a turn on the spot
//! alone.

use super::layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation, balance_rad_s, is_above, region_cause};
use super::params::CorridorFollowingParams;
use crate::signal::{LayerName, Velocity};

/// The layer and its memory.
#[derive(Debug, Clone)]
pub struct CorridorFollowing {
    params: CorridorFollowingParams,
    switch: Hysteresis,
}

impl CorridorFollowing {
    /// The layer, idle.
    #[must_use]
    pub fn new(params: &CorridorFollowingParams) -> Self {
        Self { params: params.clone(), switch: Hysteresis::new(params.trigger_count, params.release_count) }
    }
}

impl BehaviourLayer for CorridorFollowing {
    fn name(&self) -> LayerName {
        LayerName::CorridorFollowing
    }

    fn observe(&mut self, situation: &Situation) -> bool {
        let peak = f64::from(situation.cues.corridor.peak);
        self.switch.update(is_above(peak, self.params.threshold), is_above(peak, self.params.release))
    }

    fn act(&mut self, situation: &Situation) -> LayerOutput {
        let cue = &situation.cues.corridor;
        let wanted = situation.wanted;
        let away_rad_s = if situation.is_driving() { balance_rad_s(cue, self.params.lambda) } else { 0.0 };
        LayerOutput {
            velocity: Velocity { angular_rad_s: wanted.angular_rad_s - away_rad_s, ..wanted },
            cause: region_cause(cue, cue.peak, self.params.threshold),
        }
    }

    fn stand_by(&mut self) {}

    fn reset(&mut self) {
        self.switch.reset();
    }
}
