//! Whether the nearest reflection comes nearer of itself: somebody walks towards the robot.
//!
//! Goes in: the nearest reflections of a ping set, where the robot is and what was commanded. Comes out: a yes, and the place, for as
//! long as it is worth remembering; and a turn without what would bring the robot back into the walker's way. The footprint is a disc, so the robot's own turning brings nothing nearer; its driving brings things
//! nearer by at most its speed, and what is more than that has moved. Knows no law and keeps no places.

use crate::geometry::Pose2;
use crate::signal::{Cues, NearestReflection, Velocity};
use nalgebra::Vector2;

/// What must be left over between two ping sets: the range axis is right to 1 mm, and a cell is 5 mm deep. A walker makes 3 cm
/// at 0.3 m/s.
const STEP_MIN_M: f64 = 0.015;
/// What comes nearer faster than this is another reflection.
const SPEED_MAX_M_S: f64 = 1.5;
/// Ping sets in a row that must agree: one is what a new echo on the nearer side of the old one looks like.
const RUN_MIN: u32 = 2;
/// How long it is remembered.
const KEPT_S: f64 = 1.0;

/// Watches the nearest reflection.
#[derive(Debug, Clone, Default)]
pub(super) struct Approach {
    last_m: Option<f64>,
    place_m: Option<Vector2<f64>>,
    /// What is left of the speed commanded last, while the robot brakes.
    speed_m_s: f64,
    run: u32,
    left_s: f64,
    /// Where it was last, and its distance then.
    walker: Option<(Vector2<f64>, f64)>,
}

impl Approach {
    /// Takes one ping set; `last` is the velocity commanded since the one before, `decel_m_s2` how fast the robot brakes: a command to
    /// stand is not obeyed at once, and without odometry nothing else tells how far it still rolls.
    pub(super) fn observe(&mut self, cues: &Cues, pose: &Pose2, last: Velocity, decel_m_s2: f64, elapsed_s: f64) {
        let nearest = nearest_reflections(cues).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let nearest_m = nearest.map(|nearest| nearest.distance_m);
        let moved_m = self.place_m.map_or(0.0, |place_m| (pose.position_m() - place_m).norm());
        self.place_m = Some(pose.position_m());
        self.speed_m_s = last.linear_m_s.abs().max(self.speed_m_s - decel_m_s2 * elapsed_s);
        let own_m = moved_m.max(self.speed_m_s * elapsed_s);
        let nearer_m = self.last_m.zip(nearest_m).map(|(before_m, now_m)| before_m - now_m - own_m);
        let comes = nearer_m.is_some_and(|nearer_m| (STEP_MIN_M..=SPEED_MAX_M_S * elapsed_s).contains(&nearer_m));
        // Silence is no departure: what came may be too near to be heard.
        self.run = if comes { self.run.saturating_add(1) } else { self.run * u32::from(nearest_m.is_none()) };
        self.left_s = if self.run >= RUN_MIN { KEPT_S } else { self.left_s - elapsed_s };
        if let Some(nearest) = nearest.filter(|_| comes && self.run >= RUN_MIN) {
            self.walker = Some((pose.parent_from_local(nearest.place_m.into()), nearest.distance_m));
        }
        self.last_m = nearest_m;
    }

    /// The turn, without what leads back towards who walks up ahead: he keeps to his way, and the robot that has begun to leave it is not
    /// to return. What is nearer on the other side goes before.
    pub(super) fn kept_away_rad_s(&self, turn_rad_s: f64, cues: &Cues, pose: &Pose2) -> f64 {
        let Some((walker_m, distance_m)) = self.walker.filter(|_| self.is_seen()) else { return turn_rad_s };
        let place_m = pose.local_from_parent(walker_m);
        let beside = |nearest: &NearestReflection| nearest.place_m[1] * place_m.y < 0.0;
        let hemmed_in = nearest_reflections(cues).any(|nearest| beside(&nearest) && nearest.distance_m < distance_m);
        let back = place_m.x > 0.0 && turn_rad_s * place_m.y > 0.0;
        if back && !hemmed_in { 0.0 } else { turn_rad_s }
    }

    /// Whether something came nearer of itself within the last second.
    pub(super) fn is_seen(&self) -> bool {
        self.left_s > 0.0
    }
}

/// The nearest reflection of each region that has one.
fn nearest_reflections(cues: &Cues) -> impl Iterator<Item = NearestReflection> {
    [cues.collision.nearest, cues.obstacle.nearest, cues.corridor.nearest].into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::LayerCue;

    fn heard(distance_m: f64, place_m: [f64; 2]) -> LayerCue {
        let nearest = NearestReflection {
            sensor_index: 0,
            range_m: 0.4,
            bearing_rad: 0.0,
            distance_m,
            place_m,
            energy: 0.1,
            side: 1,
            lead_m: f64::INFINITY,
        };
        LayerCue { nearest: Some(nearest), ..LayerCue::default() }
    }

    fn watched(distances_m: &[f64], speed_m_s: f64) -> Approach {
        let mut approach = Approach::default();
        for &distance_m in distances_m {
            let cues = Cues { corridor: heard(distance_m, [0.5, 0.2]), ..Cues::default() };
            approach.observe(&cues, &Pose2::default(), Velocity::forward_m_s(speed_m_s), 1.0, 0.1);
        }
        approach
    }

    fn seen(distances_m: &[f64], speed_m_s: f64) -> bool {
        watched(distances_m, speed_m_s).is_seen()
    }

    #[test]
    fn a_turn_back_towards_a_walker_is_left_out_and_any_other_stays() {
        let walker = watched(&[0.50, 0.43, 0.36], 0.3);
        let here = Pose2::default();
        let silent = Cues::default();
        assert_eq!(walker.kept_away_rad_s(0.4, &silent, &here), 0.0, "he is on the left");
        assert_eq!(walker.kept_away_rad_s(-0.4, &silent, &here), -0.4);
        let behind = Pose2 { x_m: 1.0, ..here };
        assert_eq!(walker.kept_away_rad_s(0.4, &silent, &behind), 0.4, "he has passed");
        let turned = Pose2 { heading_rad: 1.0, ..here };
        assert_eq!(walker.kept_away_rad_s(-0.4, &silent, &turned), 0.0, "now he is on the right");
        let hemmed_in = |distance_m| Cues { obstacle: heard(distance_m, [0.3, -0.3]), ..Cues::default() };
        assert_eq!(walker.kept_away_rad_s(0.4, &hemmed_in(0.3), &here), 0.4, "a nearer wall on the right goes before");
        assert_eq!(walker.kept_away_rad_s(0.4, &hemmed_in(0.5), &here), 0.0, "a farther one does not");
        let wall = watched(&[0.50, 0.47, 0.44], 0.3);
        assert_eq!(wall.kept_away_rad_s(0.4, &silent, &here), 0.4, "nobody walks");
    }

    #[test]
    fn a_walker_is_told_from_a_wall_that_the_robot_drives_to() {
        assert!(seen(&[0.50, 0.46, 0.42], 0.0), "the robot stands");
        assert!(seen(&[0.50, 0.43, 0.36], 0.3), "the robot drives too");
        assert!(!seen(&[0.50, 0.47, 0.44, 0.41], 0.3), "a wall");
        assert!(!seen(&[0.50, 0.46, 0.46, 0.42], 0.0), "an echo that flickers");
        assert!(!seen(&[0.50, 0.25, 0.02], 0.0), "other echoes");
        assert!(!seen(&[0.50, f64::NAN, 0.42], 0.0));
    }
}
