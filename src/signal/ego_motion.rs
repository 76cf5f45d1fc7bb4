//! How the robot moves as its own echoes tell, and what moves beside it.
//!
//! Data only: a velocity with its covariance, what odometry says of the same time, and movers in a list of fixed room. Who makes it is
//! [`crate::detect::EgoMotion`], who slows down for movers [`crate::control`].

use super::Velocity;
use crate::time::Stamp;
use nalgebra::{Matrix2, Vector2};

/// Most movers told at a time; those that would touch the robot first are kept.
pub const MOVERS_MAX: usize = 8;

/// Something that moves over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mover {
    /// Number of its track; stays while it is followed.
    pub id: u32,
    /// Its middle in the robot frame: the reflecting point, and the radius farther.
    pub position_m: Vector2<f64>,
    /// Velocity over ground along the axes of the robot frame.
    pub velocity_m_s: Vector2<f64>,
    /// Covariance of the reflecting point.
    pub position_covariance_m2: Matrix2<f64>,
    /// Covariance of the velocity.
    pub velocity_covariance_m2_s2: Matrix2<f64>,
    /// Radius that it is taken to have.
    pub radius_m: f64,
    /// Time until it touches the robot's footprint if both go on straight as they do; infinite if they miss each other.
    pub time_to_contact_s: f64,
    /// Ping sets since it was first heard.
    pub age: u32,
}

impl Default for Mover {
    fn default() -> Self {
        Self {
            id: 0,
            position_m: Vector2::zeros(),
            velocity_m_s: Vector2::zeros(),
            position_covariance_m2: Matrix2::zeros(),
            velocity_covariance_m2_s2: Matrix2::zeros(),
            radius_m: 0.0,
            time_to_contact_s: f64::INFINITY,
            age: 0,
        }
    }
}

/// The movers of a moment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Movers {
    list: [Mover; MOVERS_MAX],
    count: usize,
}

impl Movers {
    /// Enters a mover by its time to contact; the one that comes last drops out of a full list.
    pub fn enter(&mut self, mover: Mover) {
        let sooner = |other: &Mover| mover.time_to_contact_s < other.time_to_contact_s;
        let place = self.as_slice().iter().position(sooner).unwrap_or(self.count);
        if place >= MOVERS_MAX {
            return;
        }
        self.count = (self.count + 1).min(MOVERS_MAX);
        self.list[place..self.count].rotate_right(1);
        self.list[place] = mover;
    }

    /// The movers, the soonest contact first.
    #[must_use]
    pub fn as_slice(&self) -> &[Mover] {
        &self.list[..self.count]
    }
}

/// The robot's motion between the last two ping sets, by its echoes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EgoMotionReport {
    /// Sequence of the newer ping set.
    pub sequence: u64,
    /// Its emission.
    pub emitted_at: Stamp,
    /// The interval over which the velocity is the mean.
    pub interval_s: f64,
    /// V and omega that explain most of the echoes; zero where nothing is known.
    pub velocity: Velocity,
    /// Covariance of (V, omega), (m/s)^2, m/s rad/s, (rad/s)^2: as wide as the platform is fast where the echoes do not tell.
    pub covariance: Matrix2<f64>,
    /// Whether V is known better than 0.05 m/s, and omega better than 0.1 rad/s.
    pub observed: [bool; 2],
    /// Mean velocity over the same interval by odometry, where there is one.
    pub odometry: Option<Velocity>,
    /// Squared distance of the two in standard deviations, two degrees of freedom; 0 without odometry.
    pub innovation: f64,
    /// Whether odometry has contradicted the echoes for several ping sets: the wheels slip, or the robot is pushed.
    pub slip: bool,
    /// Reflectors that were heard in both ping sets.
    pub matched: usize,
    /// Of these, those that agree with the velocity.
    pub inliers: usize,
    /// What moves.
    pub movers: Movers,
}

impl Default for EgoMotionReport {
    fn default() -> Self {
        Self {
            sequence: 0,
            emitted_at: Stamp::default(),
            interval_s: 0.0,
            velocity: Velocity::ZERO,
            covariance: Matrix2::identity(),
            observed: [false; 2],
            odometry: None,
            innovation: 0.0,
            slip: false,
            matched: 0,
            inliers: 0,
            movers: Movers::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soonest_contacts_are_kept_in_order() {
        let mut movers = Movers::default();
        for id in 0..20_u32 {
            let time_to_contact_s = f64::from((id * 7) % 20);
            movers.enter(Mover { id, time_to_contact_s, ..Mover::default() });
        }
        let times_s: Vec<f64> = movers.as_slice().iter().map(|mover| mover.time_to_contact_s).collect();
        assert_eq!(times_s, (0..8).map(f64::from).collect::<Vec<_>>());
    }
}
