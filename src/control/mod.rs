//! Cues to decisions: the layered controller (paper 000, section 4; specification, section 5).
//!
//! Goes in: [`Cues`] of one ping set, the wanted velocity, "now" and, where there is one, the odometry. Comes out: a
//! [`Decision`] with its layer and cause. The order of the layers is [`layers`], and nowhere else. No I/O, no randomness, no
//! clock of its own: the same inputs give the same decisions.

mod approach;
mod collision_avoidance;
mod corridor_following;
mod corridor_law;
pub mod default_regions;
mod detour;
mod flow_following;
mod layer;
mod limits;
mod obstacle_avoidance;
pub mod params;
pub mod platform;
mod progress;
mod room;

pub use collision_avoidance::CollisionAvoidance;
pub use corridor_following::CorridorFollowing;
pub use flow_following::FlowFollowing;
pub use layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation};
pub use obstacle_avoidance::ObstacleAvoidance;
pub use params::ControlParams;
pub use platform::PlatformLimits;

use crate::geometry::Pose2;
use crate::signal::{Cause, Cues, Decision, LayerName, Movers, Velocity};
use crate::time::Stamp;
use approach::Approach;
use detour::Detour;
use progress::{Avoidance, Progress, WayOut};
use room::Room;
use std::time::Duration;

/// Age beyond which cues are not acted on, unless [`Controller::with_max_age`] says otherwise: three periods.
pub const MAX_AGE: Duration = Duration::from_millis(300);
/// What is heard this near to the footprint during a detour belongs to the obstacle that is being passed.
const DETOUR_REACH_M: f64 = 0.5;
/// How much faster than CA turns the robot turns past where no way leads out: it stands, and has stood for long enough.
const WAY_OUT_HASTE: f64 = 2.0;
/// How far in the future a stamp may lie.
const FUTURE_MAX: Duration = Duration::from_millis(50);

/// The layers that are on, highest priority first.
fn layers(params: &ControlParams, platform: &PlatformLimits) -> Vec<Box<dyn BehaviourLayer>> {
    let mut layers: Vec<Box<dyn BehaviourLayer>> = Vec::with_capacity(LayerName::LAYERS.len());
    if params.collision_avoidance.enabled {
        layers.push(Box::new(CollisionAvoidance::new(&params.collision_avoidance, 1.0 / params.rate_hz)));
    }
    if params.obstacle_avoidance.enabled {
        layers.push(Box::new(ObstacleAvoidance::new(&params.obstacle_avoidance)));
    }
    if params.flow_following.enabled {
        layers.push(Box::new(FlowFollowing::new(&params.flow_following, platform.radius_m)));
    }
    if params.corridor_following.enabled {
        layers.push(Box::new(CorridorFollowing::new(&params.corridor_following)));
    }
    layers
}

/// The layered controller and its memory.
#[derive(Debug)]
pub struct Controller {
    params: ControlParams,
    platform: PlatformLimits,
    max_age: Duration,
    layers: Vec<Box<dyn BehaviourLayer>>,
    progress: Progress,
    approach: Approach,
    detour: Detour,
    room: Room,
    /// The side to which CA turned on the last ping set, +1 or -1, if it acted.
    avoided: Option<f64>,
    last: Velocity,
    last_now: Option<Stamp>,
}

impl Controller {
    /// A controller at rest. Both arguments have been validated.
    #[must_use]
    pub fn new(params: &ControlParams, platform: &PlatformLimits) -> Self {
        Self {
            params: params.clone(),
            platform: *platform,
            max_age: MAX_AGE,
            layers: layers(params, platform),
            progress: Progress::new(&params.stuck),
            approach: Approach::default(),
            detour: Detour::new(half_lane_m(params, platform), platform.radius_m),
            room: Room::new(&params.movers, platform.radius_m),
            avoided: None,
            last: Velocity::ZERO,
            last_now: None,
        }
    }

    /// The same controller with another greatest age of cues.
    #[must_use]
    pub fn with_max_age(mut self, max_age: Duration) -> Self {
        self.max_age = max_age;
        self
    }

    /// Decides on one ping set, without odometry. `now` is the present moment; in a replay the ping's own time.
    pub fn step(&mut self, now: Stamp, cues: &Cues, wanted: Velocity) -> Decision {
        self.step_with_odometry(now, cues, wanted, None)
    }

    /// Decides on one ping set. The pose serves to judge progress, who walks up, and where places lie that are being passed; without
    /// one the commands are added up.
    ///
    /// Stands still, with layer [`LayerName::Stopped`], when the cues are older than the greatest age or more than 50 ms in
    /// the future, when no sensor went into them, and when the wanted velocity is not finite.
    pub fn step_with_odometry(
        &mut self,
        now: Stamp,
        cues: &Cues,
        wanted: Velocity,
        odometry: Option<Pose2>,
    ) -> Decision {
        let elapsed_s = self.elapsed_s(now);
        if !self.is_fresh(now, cues) || !wanted.is_finite() || !cues.sensors_used.contains(&true) {
            return self.stop(cues);
        }
        let wanted = limits::within_platform(wanted, &self.platform);
        let collision = f64::from(cues.collision.energy);
        let is_clear = !layer::is_above(collision, self.params.collision_avoidance.release);
        let is_loud = layer::is_above(collision, self.params.collision_avoidance.threshold);
        let avoidance = Avoidance { turn: self.avoided, is_clear, is_loud };
        // Who waits for somebody to pass asks for no progress.
        let asked = if self.room.waits() { Velocity::ZERO } else { wanted };
        self.progress.observe(odometry, self.last, asked, &avoidance, elapsed_s);
        let decel_m_s2 = self.platform.max_linear_accel_m_s2;
        self.approach.observe(cues, &self.progress.pose(), self.last, decel_m_s2, elapsed_s);
        let approaching = self.approach.is_seen();
        let avoids = self.avoided.is_some() || (self.progress.turns_out() && !is_clear);
        // Who walks does not stay there.
        let avoided = cues.collision.nearest.filter(|_| avoids && !approaching);
        let beside = cues.obstacle.nearest.filter(|nearest| {
            self.detour.is_under_way() && nearest.distance_m <= DETOUR_REACH_M && self.obstacle_is_heard(cues)
        });
        let heard_m = [avoided, beside].map(|nearest| nearest.map(|nearest| nearest.place_m.into()));
        self.detour.observe(&self.progress.pose(), heard_m, elapsed_s);
        if is_clear && self.params.obstacle_avoidance.enabled && !self.obstacle_is_heard(cues) {
            self.detour.forget_ahead(&self.progress.pose());
        }
        let asked_rad_s = wanted.angular_rad_s;
        let wanted = self.detour.guard(&self.progress.pose(), wanted);
        let situation = Situation { cues, wanted, asked_rad_s, approaching, last: self.last, elapsed_s };
        let (layer, mut output) = self.ask_layers(&situation);
        if layer != LayerName::CollisionAvoidance {
            let turn_rad_s = &mut output.velocity.angular_rad_s;
            *turn_rad_s = self.approach.kept_away_rad_s(*turn_rad_s, cues, &self.progress.pose());
        }
        let avoids = layer == LayerName::CollisionAvoidance && !self.progress.is_stuck();
        self.avoided = avoids.then(|| output.velocity.angular_rad_s.signum());
        let ahead_m_s = self.speed_for_way_m_s(cues.coverage.ahead_m);
        let behind_m_s = self.speed_for_way_m_s(cues.coverage.behind_m);
        let mut asked = limits::within_platform(output.velocity, &self.platform);
        asked.linear_m_s = asked.linear_m_s.clamp(-behind_m_s, ahead_m_s);
        asked.linear_m_s = self.room.limited_m_s(asked.linear_m_s, now, elapsed_s);
        let growth_s = elapsed_s.min(2.0 / self.params.rate_hz);
        self.last = limits::rate_limited(self.last, asked, growth_s, &self.platform);
        Decision {
            emitted_at: cues.emitted_at,
            velocity: self.last,
            layer,
            cause: output.cause,
            speed_limit_m_s: ahead_m_s,
            stuck: self.progress.is_stuck(),
        }
    }

    /// Takes what moves, as it was heard in the ping set of `emitted_at`: where `[control.movers]` is enabled the next decisions give
    /// it room, by less forward speed than without it and nothing else.
    pub fn give_room(&mut self, movers: &Movers, emitted_at: Stamp) {
        self.room.tell(movers, emitted_at);
    }

    /// Forgets everything but the parameters.
    pub fn reset(&mut self) {
        self.layers.iter_mut().for_each(|layer| layer.reset());
        self.progress = Progress::new(&self.params.stuck);
        self.approach = Approach::default();
        self.detour.forget();
        self.room.forget();
        self.avoided = None;
        (self.last, self.last_now) = (Velocity::ZERO, None);
    }

    /// Lets all layers observe and the highest triggered one act. A stuck robot tries its way out instead: the wanted velocity
    /// under CA alone, or a turn on the spot, which counts as collision avoidance.
    fn ask_layers(&mut self, situation: &Situation) -> (LayerName, LayerOutput) {
        let way_out = self.progress.is_stuck().then(|| {
            let loud_left = situation.cues.collision.turn + situation.cues.obstacle.turn;
            // Equally loud on both sides: the way that is wanted, else left.
            let aside = if loud_left == 0.0 { situation.asked_rad_s } else { -f64::from(loud_left) };
            let known = self.detour.way_out(&self.progress.pose(), situation.asked_rad_s);
            self.progress.way_out(situation.wanted, known, if aside < 0.0 { -1.0 } else { 1.0 })
        });
        let mut acting: Option<(LayerName, LayerOutput)> = None;
        for layer in &mut self.layers {
            if matches!(way_out, Some(WayOut::Turn(_))) {
                // What led here is not to go on afterwards: CA chooses its side anew.
                layer.reset();
            }
            let may_act = match way_out {
                None => true,
                Some(WayOut::LetGo) => layer.name() == LayerName::CollisionAvoidance,
                Some(WayOut::Turn(_)) => false,
            };
            if layer.observe(situation) && may_act && acting.is_none() {
                acting = Some((layer.name(), layer.act(situation)));
            } else {
                layer.stand_by();
            }
        }
        if let Some(WayOut::Turn(turn)) = way_out {
            return (LayerName::CollisionAvoidance, self.turn_on_the_spot(situation, turn));
        }
        let passed_through = LayerOutput { velocity: situation.wanted, cause: Cause::default() };
        acting.unwrap_or((LayerName::PassThrough, passed_through))
    }

    fn turn_on_the_spot(&self, situation: &Situation, turn: f64) -> LayerOutput {
        let params = &self.params.collision_avoidance;
        let cue = &situation.cues.collision;
        // A way out may be narrow: no haste where one may be.
        let may_lead_out = !layer::is_above(f64::from(cue.energy), params.threshold) && situation.is_driving();
        let omega_rad_s = if may_lead_out { params.omega_rad_s } else { WAY_OUT_HASTE * params.omega_rad_s };
        LayerOutput {
            velocity: Velocity { linear_m_s: 0.0, angular_rad_s: turn * omega_rad_s },
            cause: layer::region_cause(cue, cue.energy, params.threshold),
        }
    }

    fn stop(&mut self, cues: &Cues) -> Decision {
        self.layers.iter_mut().for_each(|layer| layer.stand_by());
        self.last = Velocity::ZERO;
        Decision {
            emitted_at: cues.emitted_at,
            velocity: Velocity::ZERO,
            layer: LayerName::Stopped,
            cause: Cause::default(),
            speed_limit_m_s: 0.0,
            stuck: self.progress.is_stuck(),
        }
    }

    fn is_fresh(&self, now: Stamp, cues: &Cues) -> bool {
        let age_ns = i128::from(now.since_ns(cues.emitted_at));
        age_ns <= self.max_age.as_nanos().cast_signed() && age_ns >= -FUTURE_MAX.as_nanos().cast_signed()
    }

    /// Time since the last step, at most the greatest age; one period for the first.
    fn elapsed_s(&mut self, now: Stamp) -> f64 {
        let period_s = 1.0 / self.params.rate_hz;
        let before = self.last_now.replace(now);
        before.map_or(period_s, |before| (now.since_ns(before) as f64 * 1e-9).clamp(0.0, self.max_age.as_secs_f64()))
    }

    fn obstacle_is_heard(&self, cues: &Cues) -> bool {
        layer::is_above(f64::from(cues.obstacle.peak), self.params.obstacle_avoidance.release)
    }

    fn speed_for_way_m_s(&self, seen_m: f64) -> f64 {
        limits::speed_for_way_m_s(seen_m, self.params.coverage.reaction_s, &self.platform)
    }
}

/// Half width of the CA region ahead of the axle, and at least the footprint's.
fn half_lane_m(params: &ControlParams, platform: &PlatformLimits) -> f64 {
    const STEP_M: f64 = 0.02;
    const REACH: i32 = 150;
    let regions = &params.collision_avoidance.regions;
    let touched = |across: &i32| {
        (0..REACH).flat_map(|ahead| [1.0, -1.0].map(|side| (ahead, side))).any(|(ahead, side)| {
            let point_m = nalgebra::Vector2::new(f64::from(ahead) * STEP_M, side * f64::from(*across) * STEP_M);
            regions.iter().any(|region| region.contains(point_m))
        })
    };
    let widest = (0..REACH).rev().find(touched).unwrap_or(0);
    (f64::from(widest) * STEP_M).max(platform.radius_m) + STEP_M
}
