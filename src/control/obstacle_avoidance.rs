//! OA: slow down and steer away from the louder side of the way ahead (paper 000, eq. 12, with |M| and guarded quotients).
//!
//! Goes in: the cue of the OA region. Comes out: omega_i - lambda sum(E M / r^2) / sum(E|M|) and
//! V_i clamp(1 - mu sum(E|M|) / E_ref, 0, 1). Never speeds up, never reverses what was wanted forward; leaves a turn on the
//! spot alone.

use super::layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation, balance_rad_s, is_above, region_cause};
use super::params::ObstacleAvoidanceParams;
use crate::signal::{LayerCue, LayerName, Velocity};

/// The layer and its memory.
#[derive(Debug, Clone)]
pub struct ObstacleAvoidance {
    params: ObstacleAvoidanceParams,
    switch: Hysteresis,
}

impl ObstacleAvoidance {
    /// The layer, idle.
    #[must_use]
    pub fn new(params: &ObstacleAvoidanceParams) -> Self {
        Self { params: params.clone(), switch: Hysteresis::new(params.trigger_count, params.release_count) }
    }

    /// Share of the wanted speed that is left, 0 to 1; 0 where the energy is no number. One obstacle is counted by every sensor that
    /// hears it, so E_ref is that many times as large: a layout of three sensors slows down as one of a single sensor does.
    fn speed_share(&self, cue: &LayerCue) -> f64 {
        let energy = f64::from(cue.energy);
        let hearing = cue.sensors.iter().filter(|sensor| sensor.energy > 0.0).count().max(1);
        if self.params.mu == 0.0 && energy.is_finite() {
            return 1.0;
        }
        let share = 1.0 - self.params.mu * energy / (hearing as f64 * self.params.energy_reference);
        if share > 0.0 { share.min(1.0) } else { 0.0 }
    }
}

impl BehaviourLayer for ObstacleAvoidance {
    fn name(&self) -> LayerName {
        LayerName::ObstacleAvoidance
    }

    fn observe(&mut self, situation: &Situation) -> bool {
        let peak = f64::from(situation.cues.obstacle.peak);
        self.switch.update(is_above(peak, self.params.threshold), is_above(peak, self.params.release))
    }

    fn act(&mut self, situation: &Situation) -> LayerOutput {
        let (cue, wanted) = (&situation.cues.obstacle, situation.wanted);
        let away_rad_s = if situation.is_driving() { balance_rad_s(cue, self.params.lambda) } else { 0.0 };
        LayerOutput {
            velocity: Velocity {
                linear_m_s: wanted.linear_m_s * self.speed_share(cue),
                angular_rad_s: wanted.angular_rad_s - away_rad_s,
            },
            cause: region_cause(cue, cue.peak, self.params.threshold),
        }
    }

    fn stand_by(&mut self) {}

    fn reset(&mut self) {
        self.switch.reset();
    }
}
