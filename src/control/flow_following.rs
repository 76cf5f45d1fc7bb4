//! AFF: keep the distance from one wall, or the middle between two (paper 000, eq. 15 and 16).
//!
//! Goes in: walls found along flow lines, with signed lateral distances (left positive). One wall:
//! omega_i + lambda (d_s - d_p), d_p its distance one activation ago. Two: omega_i + lambda (d_l + d_r) + lambda_d times the
//! filtered rate of that sum; the paper's eq. 16 has unsigned distances and no damping, with which the delay of a ping
//! makes the robot swing ever wider (specification, section 5). How steep the way to the middle may be, and that a corridor is not
//! forgotten with the first wall that falls silent, is told in [`super::corridor_law`]. V = V_i.

use super::corridor_law::{CorridorLaw, SAME_WALL_M};
use super::layer::{BehaviourLayer, Hysteresis, LayerOutput, Situation};
use super::params::FlowFollowingParams;
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::signal::{Cause, LayerName, Velocity, WallPeak, WallPeaks};

/// Of the walls on one side those at least this share as strong as the strongest are taken for walls; the nearest of them is
/// followed, since beyond a wall there are only its own side lobes and what is heard past its end.
const STRONG_SHARE: f64 = 0.5;
/// Room that a single wall must leave beside the footprint to be followed. At a nearer one the robot would creep along the edge of
/// the CA zone; corridor following, which weighs by 1 / r^2, takes it away from there. Between two walls the law itself does.
const ROOM_MIN_M: f64 = 0.3;

/// The layer and its memory.
#[derive(Debug, Clone)]
pub struct FlowFollowing {
    params: FlowFollowingParams,
    /// Least lateral distance of a single wall that is followed.
    nearest_wall_m: f64,
    radius_m: f64,
    single: Hysteresis,
    corridor: Hysteresis,
    /// d_p of eq. 15.
    previous_wall_m: Option<f64>,
    law: CorridorLaw,
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
            law: CorridorLaw::new(params.lambda, params.derivative_filter_s, abeam_m(params)),
            elapsed_s: 0.0,
        }
    }

    /// The walls above a threshold and farther than `nearest_m`, strongest first. A wall is followed only when its numbers are
    /// numbers: steering by NaN is no way to avoid anything.
    fn walls(walls: &WallPeaks, threshold: f64, nearest_m: f64) -> impl Iterator<Item = &WallPeak> + Clone {
        walls.as_slice().iter().filter(move |wall| {
            let sound = wall.strength.is_finite() && wall.lateral_m.is_finite();
            sound && wall.strength > threshold && wall.lateral_m.abs() > nearest_m
        })
    }

    /// The wall to follow on the left and on the right: the nearest of the strong ones above a threshold.
    fn sides(walls: &WallPeaks, threshold: f64, nearest_m: f64) -> [Option<&WallPeak>; 2] {
        [1.0, -1.0].map(|side| {
            let on_side = Self::walls(walls, threshold, nearest_m).filter(move |wall| wall.lateral_m * side > 0.0);
            let strongest = on_side.clone().map(|wall| wall.strength).next()?;
            let strong = on_side.filter(move |wall| wall.strength >= STRONG_SHARE * strongest);
            strong.min_by(|a, b| a.lateral_m.abs().total_cmp(&b.lateral_m.abs()))
        })
    }

    /// Both walls of a corridor, however near.
    fn corridor_sides<'a>(&self, walls: &'a WallPeaks, threshold: f64) -> [Option<&'a WallPeak>; 2] {
        Self::sides(walls, threshold, self.radius_m)
    }

    /// The only wall, or of two the nearer.
    fn single<'a>(&self, walls: &'a WallPeaks, threshold: f64) -> Option<&'a WallPeak> {
        match Self::sides(walls, threshold, self.nearest_wall_m) {
            [Some(left), Some(right)] => Some(if left.lateral_m <= -right.lateral_m { left } else { right }),
            [one, other] => one.or(other),
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

    /// The walls of the corridor, the strength of the weaker, and whether both are heard: those heard, or, for a while, one of them
    /// and the width.
    fn corridor_walls(&self, walls: &WallPeaks, wanted: Velocity) -> Option<([f64; 2], f64, bool)> {
        let sides = self.corridor_sides(walls, self.released(self.params.threshold_corridor));
        let completed = |wall: &WallPeak| Some((self.law.completed_m(wall.lateral_m, wanted)?, wall.strength, false));
        let [left, right] = sides.map(|side| side.and_then(completed));
        match sides {
            // Those of the corridor that was followed a moment ago need not be found anew.
            [Some(one), Some(other)] if self.corridor.is_on() || (left.is_some() && right.is_some()) => {
                Some(([one.lateral_m, other.lateral_m], one.strength.min(other.strength), true))
            }
            _ => left.or(right),
        }
    }
}

/// How far flow lines reach, ahead as behind.
fn abeam_m(params: &FlowFollowingParams) -> f64 {
    let reach_m = |region: &FlowLinesRegion| region.x_m[1].min(-region.x_m[0]).max(0.0);
    params.regions.iter().map(reach_m).fold(0.0, f64::max)
}

impl BehaviourLayer for FlowFollowing {
    fn name(&self) -> LayerName {
        LayerName::FlowFollowing
    }

    fn observe(&mut self, situation: &Situation) -> bool {
        let walls = &situation.cues.walls;
        self.elapsed_s += situation.elapsed_s;
        self.law.advance(situation.last, situation.elapsed_s);
        let both = |threshold: f64| matches!(self.corridor_sides(walls, threshold), [Some(_), Some(_)]);
        let any = |threshold: f64| Self::walls(walls, threshold, self.nearest_wall_m).next().is_some();
        let (single, corridor) = (self.params.threshold_single, self.params.threshold_corridor);
        let (single_hold, corridor_hold) = (self.released(single), self.released(corridor));
        let (corridor_fires, corridor_holds) = (both(corridor), both(corridor_hold));
        let (single_fires, single_holds) = (any(single), any(single_hold));
        let in_corridor = self.corridor.update(corridor_fires, corridor_holds);
        let along_wall = self.single.update(single_fires, single_holds);
        in_corridor || along_wall || self.corridor_walls(walls, situation.wanted).is_some()
    }

    fn act(&mut self, situation: &Situation) -> LayerOutput {
        let (walls, wanted) = (&situation.cues.walls, situation.wanted);
        let single_hold = self.released(self.params.threshold_single);
        let (turn_rad_s, energy, threshold) = match self.corridor_walls(walls, wanted) {
            Some((walls_m, strength, heard)) => {
                self.previous_wall_m = None;
                let turn_rad_s = self.law.rate_rad_s(walls_m, heard, wanted.linear_m_s);
                (turn_rad_s, strength, self.params.threshold_corridor)
            }
            None => {
                self.law.forget();
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
        self.law.forget();
    }

    fn reset(&mut self) {
        *self = Self::new(&self.params, self.radius_m);
    }
}
