//! Where the microphones are by the time the sound comes back.
//!
//! Pose and velocity of the robot at the emission in, lengths of paths to the moved microphones out. To second order in
//! speed over speed of sound; what it leaves out is said in [`super`].

use super::path::Path;
use crate::geometry::Pose2;
use crate::signal::Velocity;
use nalgebra::Vector2;

/// The robot's motion while the sound flies.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Motion {
    robot_m: Vector2<f64>,
    /// Way of the robot's centre, and its turn, for each metre that the sound flies.
    drift: Vector2<f64>,
    turn_rad_m: f64,
    moves: bool,
}

impl Motion {
    pub(super) fn new(robot: &Pose2, velocity: Velocity, speed_of_sound_m_s: f64) -> Self {
        let ahead = Vector2::new(robot.heading_rad.cos(), robot.heading_rad.sin());
        Self {
            robot_m: robot.position_m(),
            drift: ahead * (velocity.linear_m_s / speed_of_sound_m_s),
            turn_rad_m: velocity.angular_rad_s / speed_of_sound_m_s,
            moves: velocity != Velocity::ZERO,
        }
    }

    /// Length and amplitude of `path` to a microphone that was at `place_m` when the sound set out.
    pub(super) fn heard(&self, path: &Path, place_m: Vector2<f64>, height_m: f64) -> (f64, f64) {
        let (length_m, amplitude) = path.at(place_m, height_m);
        if !self.moves {
            return (length_m, amplitude);
        }
        let moved_m = path.at(self.moved(place_m, length_m), height_m).0;
        // The way it has moved grows with the length found: one step of a geometric series.
        let change_m = moved_m - length_m;
        (length_m + change_m * (1.0 + change_m / length_m), amplitude)
    }

    /// Where a place on the robot is once the sound has flown `length_m`.
    fn moved(&self, place_m: Vector2<f64>, length_m: f64) -> Vector2<f64> {
        // An arc's chord points half the turn aside.
        let turn_rad = self.turn_rad_m * length_m;
        let arm = turned(place_m - self.robot_m, turn_rad);
        self.robot_m + turned(self.drift * length_m, 0.5 * turn_rad) + arm
    }
}

fn turned(vector: Vector2<f64>, angle_rad: f64) -> Vector2<f64> {
    let (sin, cos) = angle_rad.sin_cos();
    Vector2::new(cos * vector.x - sin * vector.y, sin * vector.x + cos * vector.y)
}
