//! Whether odometry tells the truth: what the wheels report against what the echoes say.
//!
//! Goes in: the difference of the two velocities and its covariance, a ping set at a time. Comes out: an alarm, never a command. One
//! contradiction is no slip, since an echo may be lost and another taken for it; the sum of what exceeds the expected rises over
//! several ping sets (a one-sided CUSUM of the squared distance) and falls again. Knows no echoes and no clock.

use nalgebra::{Matrix2, Vector2};

/// What a ping set may add, so that one of them alone never raises the alarm.
const STEP_MAX: f64 = 12.0;
/// What is taken off: the squared distance has a mean of 2, and is above this in one of 90 ping sets.
const ALLOWANCE: f64 = 9.0;
/// Sum at which the alarm is raised: three clear contradictions in a row.
const RAISE: f64 = 8.5;
/// And up to which the sum may grow, so that it ends soon after the slip does.
const FULL: f64 = 12.0;
/// Standard deviations of odometry: of a wheel that does not slip, its diameter and its moment.
const ODOMETRY_SHARE: f64 = 0.05;
const ODOMETRY_M_S: f64 = 0.015;
const ODOMETRY_RAD_S: f64 = 0.04;

/// Watches odometry.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SlipMonitor {
    sum: f64,
    raised: bool,
}

impl SlipMonitor {
    /// Takes the squared distance of a ping set; whether the alarm is raised then. What is no number changes nothing.
    pub fn observe(&mut self, squared: f64) -> bool {
        if squared.is_finite() {
            self.sum = (self.sum + squared.clamp(0.0, STEP_MAX) - ALLOWANCE).clamp(0.0, FULL);
            self.raised = if self.raised { self.sum > 0.0 } else { self.sum >= RAISE };
        }
        self.raised
    }

    /// Whether the alarm is raised.
    #[must_use]
    pub fn is_raised(&self) -> bool {
        self.raised
    }
}

/// Squared distance between the echoes' (V, omega), known with `covariance`, and odometry's, in standard deviations.
#[must_use]
pub fn squared_distance(echoes: Vector2<f64>, covariance: &Matrix2<f64>, odometry: Vector2<f64>) -> f64 {
    let off = echoes - odometry;
    let inverse = (covariance + odometry_covariance(odometry)).try_inverse();
    inverse.map_or(0.0, |inverse| off.dot(&(inverse * off)).max(0.0))
}

/// What odometry's (V, omega) may be wrong by without any slip.
#[must_use]
pub fn odometry_covariance(odometry: Vector2<f64>) -> Matrix2<f64> {
    let sigma = Vector2::new(
        ODOMETRY_M_S.hypot(ODOMETRY_SHARE * odometry.x),
        ODOMETRY_RAD_S.hypot(ODOMETRY_SHARE * odometry.y),
    );
    Matrix2::from_diagonal(&sigma.component_mul(&sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raised_after(squares: &[f64]) -> Option<usize> {
        let mut monitor = SlipMonitor::default();
        squares.iter().position(|squared| monitor.observe(*squared))
    }

    #[test]
    fn three_contradictions_in_a_row_raise_the_alarm_and_single_ones_never_do() {
        assert_eq!(raised_after(&[1.0, 50.0, 50.0, 50.0, 50.0]), Some(3));
        assert_eq!(raised_after(&[50.0, 2.0, 50.0, 2.0, 1.0, 50.0, 0.5].repeat(20)), None);
        assert_eq!(raised_after(&[8.9; 200]), None, "within what is allowed");
        assert_eq!(raised_after(&[f64::NAN; 50]), None);
    }

    #[test]
    fn the_alarm_ends_with_the_slip() {
        let mut monitor = SlipMonitor::default();
        (0..100).for_each(|_| assert!(monitor.observe(100.0) || monitor.sum < RAISE));
        let ends = (0..10).position(|_| !monitor.observe(1.0));
        assert_eq!(ends, Some(1), "two quiet ping sets");
    }

    #[test]
    fn what_the_echoes_do_not_tell_contradicts_nothing() {
        let wide = Matrix2::new(0.25, 0.0, 0.0, 1e-4);
        let same_turn = squared_distance(Vector2::new(0.0, 0.1), &wide, Vector2::new(0.3, 0.1));
        assert!(same_turn < 0.5, "V is not known: {same_turn}");
        let other_turn = squared_distance(Vector2::new(0.0, 0.1), &wide, Vector2::new(0.3, 0.5));
        assert!(other_turn > 30.0, "omega is: {other_turn}");
    }
}
