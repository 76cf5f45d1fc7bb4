//! How the robot moves by its own echoes, and what moves beside it, as it lies in shared memory.
//!
//! Layout only, and the conversion from [`EgoMotionReport`].

use super::wire_type;
use crate::signal::{EgoMotionReport, MOVERS_MAX};
use iceoryx2::prelude::ZeroCopySend;

wire_type! {
    /// Velocity by acoustic flow beside odometry's, an alarm where they contradict each other, and movers.
    EgoMotion = "noctule.EgoMotion.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the newer ping set.
        sequence: u64,
        /// Its oldest emission, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When it was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// Time since the ping set before; the velocities are means over it. 0 where there was none.
        interval_s: f64,
        /// Forward speed by the echoes.
        linear_m_s: f64,
        /// Turn rate by the echoes.
        angular_rad_s: f64,
        /// Variance of the speed: as wide as the platform is fast where the echoes do not tell.
        variance_linear_m2_s2: f64,
        /// Covariance of speed and turn rate.
        covariance_m_rad_s2: f64,
        /// Variance of the turn rate.
        variance_angular_rad2_s2: f64,
        /// Forward speed by odometry over the same interval; NaN without odometry.
        odometry_linear_m_s: f64,
        /// Turn rate by odometry; NaN without odometry.
        odometry_angular_rad_s: f64,
        /// Squared distance of the two in standard deviations, two degrees of freedom.
        innovation: f64,
        /// Movers, the soonest contact first: middle in the robot frame, forward.
        mover_x_m: [f64; MOVERS_MAX],
        /// To the left.
        mover_y_m: [f64; MOVERS_MAX],
        /// Velocity over ground along the robot's axes, forward.
        mover_x_m_s: [f64; MOVERS_MAX],
        /// To the left.
        mover_y_m_s: [f64; MOVERS_MAX],
        /// Variance of that velocity, forward.
        mover_variance_x_m2_s2: [f64; MOVERS_MAX],
        /// Covariance of its two parts.
        mover_covariance_xy_m2_s2: [f64; MOVERS_MAX],
        /// Variance to the left.
        mover_variance_y_m2_s2: [f64; MOVERS_MAX],
        /// Radius that each is taken to have.
        mover_radius_m: [f64; MOVERS_MAX],
        /// Time until it touches the footprint if both go on straight; +inf if they miss each other.
        mover_contact_s: [f64; MOVERS_MAX],
        /// Number of its track; stays while it is followed.
        mover_id: [u32; MOVERS_MAX],
        /// Ping sets since it was first heard.
        mover_age: [u32; MOVERS_MAX],
        /// Number of movers.
        mover_count: u32,
        /// Reflectors that were heard in both ping sets.
        matched_count: u32,
        /// Of these, those that agree with the velocity.
        inlier_count: u32,
        /// Whether the speed is known better than 0.05 m/s.
        linear_observed: u32,
        /// Whether the turn rate is known better than 0.1 rad/s.
        angular_observed: u32,
        /// Whether odometry has contradicted the echoes for several ping sets: wheels slip, or the robot is pushed.
        slip: u32,
    }
}

impl EgoMotion {
    /// Takes over a report that was complete at `completed_ns` of CLOCK_BOOTTIME.
    #[must_use]
    pub fn new(report: &EgoMotionReport, completed_ns: u64) -> Self {
        let odometry = report.odometry.map_or([f64::NAN; 2], |wheels| [wheels.linear_m_s, wheels.angular_rad_s]);
        let movers = report.movers.as_slice();
        let of =
            |value: fn(&crate::signal::Mover) -> f64| std::array::from_fn(|index| movers.get(index).map_or(0.0, value));
        Self {
            sequence: report.sequence,
            t_monotonic_ns: report.emitted_at.boottime_ns,
            t_wall_ns: report.emitted_at.wall_ns,
            t_completed_ns: completed_ns,
            interval_s: report.interval_s,
            linear_m_s: report.velocity.linear_m_s,
            angular_rad_s: report.velocity.angular_rad_s,
            variance_linear_m2_s2: report.covariance.m11,
            covariance_m_rad_s2: report.covariance.m12,
            variance_angular_rad2_s2: report.covariance.m22,
            odometry_linear_m_s: odometry[0],
            odometry_angular_rad_s: odometry[1],
            innovation: report.innovation,
            mover_x_m: of(|mover| mover.position_m.x),
            mover_y_m: of(|mover| mover.position_m.y),
            mover_x_m_s: of(|mover| mover.velocity_m_s.x),
            mover_y_m_s: of(|mover| mover.velocity_m_s.y),
            mover_variance_x_m2_s2: of(|mover| mover.velocity_covariance_m2_s2.m11),
            mover_covariance_xy_m2_s2: of(|mover| mover.velocity_covariance_m2_s2.m12),
            mover_variance_y_m2_s2: of(|mover| mover.velocity_covariance_m2_s2.m22),
            mover_radius_m: of(|mover| mover.radius_m),
            mover_contact_s: of(|mover| mover.time_to_contact_s),
            mover_id: std::array::from_fn(|index| movers.get(index).map_or(0, |mover| mover.id)),
            mover_age: std::array::from_fn(|index| movers.get(index).map_or(0, |mover| mover.age)),
            mover_count: movers.len() as u32,
            matched_count: report.matched as u32,
            inlier_count: report.inliers as u32,
            linear_observed: u32::from(report.observed[0]),
            angular_observed: u32::from(report.observed[1]),
            slip: u32::from(report.slip),
            ..Self::blank()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Mover, Velocity};
    use nalgebra::Vector2;

    #[test]
    fn what_odometry_does_not_say_is_no_number_and_movers_are_in_order() {
        let mut report = EgoMotionReport { velocity: Velocity::forward_m_s(0.25), ..EgoMotionReport::default() };
        let far = Mover { id: 7, position_m: Vector2::new(1.0, 2.0), ..Mover::default() };
        report.movers.enter(far);
        report.movers.enter(Mover { id: 9, time_to_contact_s: 1.5, ..Mover::default() });
        let wire = EgoMotion::new(&report, 3);
        assert!(wire.odometry_linear_m_s.is_nan() && wire.odometry_angular_rad_s.is_nan());
        assert_eq!((wire.mover_count, wire.mover_id[..3].to_vec()), (2, vec![9, 7, 0]));
        assert_eq!((wire.mover_contact_s[0], wire.mover_contact_s[1], wire.mover_y_m[1]), (1.5, f64::INFINITY, 2.0));
        assert_eq!((wire.linear_m_s, wire.t_completed_ns, wire.slip), (0.25, 3, 0));
    }
}
