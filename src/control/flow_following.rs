//! AFF: keep the distance from one wall, or the middle between two (paper 000, eq. 15 and 16).
//!
//! Goes in: walls found along flow lines, with signed lateral distances (left positive). One wall:
//! omega_i + lambda (d_s - d_p), d_p its distance one activation ago. Two: omega_i + lambda (d_l + d_r) + lambda_d times the
//! filtered rate of that sum; the paper's eq. 16 has unsigned distances and no damping, with which the delay of a ping
//! makes the robot swing ever wider (specification, section 5). V = V_i.

use super::layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation};
use super::params::FlowFollowingParams;
use crate::signal::{Cause, LayerName, Velocity, WallPeak, WallPeaks};

/// Damping ratio of the corridor law.
const DAMPING_RATIO: f64 = 0.7;
/// Of the walls on one side those at least this share as strong as the strongest are taken for walls; the nearest of them is
/// followed, since beyond a wall there are only its own side lobes and what is heard past its end.
const STRONG_SHARE: f64 = 0.5;
/// Speed below which the damping does not grow any more.
const DAMPING_SPEED_MIN_M_S: f64 = 0.1;
/// A wall whose distance changes between two activations by this much more than the robot can have moved is another wall.
const SAME_WALL_M: f64 = 0.1;
/// Room that a wall must leave beside the footprint to be followed. At a nearer one the robot would creep along the edge of the
/// CA zone; corridor following, which weighs by 1 / r^2, takes it away from there.
const ROOM_MIN_M: f64 = 0.3;

/// The layer and its memory.
#[derive(Debug, Clone)]
pub struct FlowFollowing {
    params: FlowFollowingParams,
    /// Least lateral distance of a wall that is followed.
    nearest_wall_m: f64,
    radius_m: f64,
    single: Hysteresis,
    corridor: Hysteresis,
    /// d_p of eq. 15.
    previous_wall_m: Option<f64>,
    previous_offset_m: Option<f64>,
    offset_rate_m_s: f64,
    elapsed_s: f64,
}

impl FlowFollowing {
    /// The layer, idle. What lies nearer to the x axis than the footprint's radius `radius_m` and some room is no wall to follow.
    #[must_use]
    pub fn new(params: &FlowFollowingParams, radius_m: f64) -> Self {
        let switch = Hysteresis::new(params.trigger_count, params.release_count);
        Self {
            params: params.clone(),
            nearest_wall_m: radius_m + ROOM_MIN_M,
            radius_m,
            single: switch.clone(),
            corridor: switch,
            previous_wall_m: None,
            previous_offset_m: None,
            offset_rate_m_s: 0.0,
            elapsed_s: 0.0,
        }
    }

    /// The walls above a threshold, strongest first. A wall is followed only when its numbers are numbers: steering by NaN is
    /// no way to avoid anything.
    fn walls<'a>(&self, walls: &'a WallPeaks, threshold: f64) -> impl Iterator<Item = &'a WallPeak> + Clone + use<'a> {
        let nearest_m = self.nearest_wall_m;
        walls.as_slice().iter().filter(move |wall| {
            let sound = wall.strength.is_finite() && wall.lateral_m.is_finite();
            sound && wall.strength > threshold && wall.lateral_m.abs() > nearest_m
        })
    }

    /// The wall to follow on the left and on the right: the nearest of the strong ones above a threshold.
    fn sides<'a>(&self, walls: &'a WallPeaks, threshold: f64) -> (Option<&'a WallPeak>, Option<&'a WallPeak>) {
        let nearest = |side: f64| {
            let on_side = self.walls(walls, threshold).filter(move |wall| wall.lateral_m * side > 0.0);
            let strongest = on_side.clone().map(|wall| wall.strength).next()?;
            let strong = on_side.filter(move |wall| wall.strength >= STRONG_SHARE * strongest);
            strong.min_by(|a, b| a.lateral_m.abs().total_cmp(&b.lateral_m.abs()))
        };
        (nearest(1.0), nearest(-1.0))
    }

    /// The only wall, or of two the nearer.
    fn single<'a>(&self, walls: &'a WallPeaks, threshold: f64) -> Option<&'a WallPeak> {
        match self.sides(walls, threshold) {
            (Some(left), Some(right)) => Some(if left.lateral_m <= -right.lateral_m { left } else { right }),
            (one, other) => one.or(other),
        }
    }

    fn released(&self, threshold: f64) -> f64 {
        threshold * self.params.release_ratio
    }

    /// lambda (d_s - d_p), plus lambda times what is missing to the set distance.
    fn wall_law_rad_s(&mut self, wall: &WallPeak, linear_m_s: f64) -> f64 {
        let distance_m = wall.lateral_m;
        let change_max_m = SAME_WALL_M + linear_m_s.abs() * self.elapsed_s;
        let same_wall = |previous_m: &f64| (distance_m - previous_m).abs() <= change_max_m;
        let drift_m = self.previous_wall_m.filter(same_wall).map_or(0.0, |previous_m| distance_m - previous_m);
        let missing_m =
            self.params.set_distance_m.map_or(0.0, |set_m| (distance_m.abs() - set_m) * distance_m.signum());
        (self.previous_wall_m, self.elapsed_s) = (Some(distance_m), 0.0);
        self.params.lambda * (drift_m + missing_m)
    }

    /// lambda e + lambda_d de/dt of the offset e = d_l + d_r, which is zero in the middle.
    fn corridor_law_rad_s(&mut self, left: &WallPeak, right: &WallPeak, linear_m_s: f64) -> f64 {
        let offset_m = left.lateral_m + right.lateral_m;
        // Both walls' distances change by what the robot moves sideways.
        let change_max_m = SAME_WALL_M + 2.0 * linear_m_s.abs() * self.elapsed_s;
        match self.previous_offset_m.filter(|previous_m| (offset_m - previous_m).abs() <= change_max_m) {
            Some(previous_m) if self.elapsed_s > 0.0 => {
                let rate_m_s = (offset_m - previous_m) / self.elapsed_s;
                let share = self.elapsed_s / (self.params.derivative_filter_s + self.elapsed_s);
                self.offset_rate_m_s += share * (rate_m_s - self.offset_rate_m_s);
            }
            Some(_) => {}
            None => self.offset_rate_m_s = 0.0,
        }
        (self.previous_offset_m, self.elapsed_s) = (Some(offset_m), 0.0);
        let speed_m_s = linear_m_s.abs().max(DAMPING_SPEED_MIN_M_S);
        let damping = DAMPING_RATIO * (2.0 * self.params.lambda / speed_m_s).sqrt();
        self.params.lambda * offset_m + damping * self.offset_rate_m_s
    }

    fn forget_corridor(&mut self) {
        (self.previous_offset_m, self.offset_rate_m_s) = (None, 0.0);
    }
}

impl BehaviourLayer for FlowFollowing {
    fn name(&self) -> LayerName {
        LayerName::FlowFollowing
    }

    fn observe(&mut self, situation: &Situation) -> bool {
        let walls = &situation.cues.walls;
        self.elapsed_s += situation.elapsed_s;
        let both = |threshold: f64| matches!(self.sides(walls, threshold), (Some(_), Some(_)));
        let any = |threshold: f64| self.walls(walls, threshold).next().is_some();
        let (single, corridor) = (self.params.threshold_single, self.params.threshold_corridor);
        let (single_hold, corridor_hold) = (self.released(single), self.released(corridor));
        let (corridor_fires, corridor_holds) = (both(corridor), both(corridor_hold));
        let (single_fires, single_holds) = (any(single), any(single_hold));
        let in_corridor = self.corridor.update(corridor_fires, corridor_holds);
        let along_wall = self.single.update(single_fires, single_holds);
        in_corridor || along_wall
    }

    fn act(&mut self, situation: &Situation) -> LayerOutput {
        let (walls, wanted) = (&situation.cues.walls, situation.wanted);
        let corridor = self.sides(walls, self.released(self.params.threshold_corridor));
        let single_hold = self.released(self.params.threshold_single);
        let (turn_rad_s, energy, threshold) = match corridor {
            (Some(left), Some(right)) if self.corridor.is_on() => {
                self.previous_wall_m = None;
                let weaker = left.strength.min(right.strength);
                (self.corridor_law_rad_s(left, right, wanted.linear_m_s), weaker, self.params.threshold_corridor)
            }
            _ => {
                self.forget_corridor();
                match self.single(walls, single_hold) {
                    Some(wall) if self.single.is_on() => {
                        (self.wall_law_rad_s(wall, wanted.linear_m_s), wall.strength, self.params.threshold_single)
                    }
                    // The wall is missing for less than the release count: straight on as wanted, d_p kept.
                    _ => (0.0, 0.0, self.params.threshold_single),
                }
            }
        };
        LayerOutput {
            velocity: Velocity {
                angular_rad_s: wanted.angular_rad_s + if situation.is_driving() { turn_rad_s } else { 0.0 },
                ..wanted
            },
            cause: Cause { energy, threshold, ..Cause::default() },
        }
    }

    fn stand_by(&mut self) {
        self.previous_wall_m = None;
        self.forget_corridor();
    }

    fn reset(&mut self) {
        *self = Self::new(&self.params, self.radius_m);
    }
}
