//! Heading from odometry and gyro: a Kalman filter of the heading and of the gyro's bias.
//!
//! Goes in: for every stretch of time what the wheels and what the gyro say the robot turned by. Comes out: heading, bias and
//! their uncertainty. The paper's robot was told to turn three times by 30 degrees; its wheels said 90, its gyro 96. Which is
//! true the paper does not say. We take the wheels for right but for their slip, and the 6 degrees in 19 s for the gyro's bias of
//! 0.3 degrees a second: a gyro adds up its bias also while the robot stands, wheels do not. So standing still tells the bias,
//! and the filter needs no more than that. Never moves anything and knows no map.

use crate::geometry::wrap_angle_rad;
use nalgebra::{Matrix2, Vector2};

/// How well odometry and gyro know a turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingNoise {
    /// Standard deviation of a turn by the wheels: share of the turn (slip), and what is left of it when standing.
    pub odometry_share: f64,
    /// The latter.
    pub odometry_floor_rad: f64,
    /// Noise of the gyro: standard deviation of what it adds up in one second; it grows with the root of the time.
    pub gyro_rad: f64,
    /// Standard deviation of the change of its bias in one second, likewise.
    pub bias_walk_rad_s: f64,
}

impl Default for HeadingNoise {
    /// Wheels that slip by 2 %, a gyro of the kind in toys.
    fn default() -> Self {
        Self {
            odometry_share: 0.02,
            odometry_floor_rad: 0.05_f64.to_radians(),
            gyro_rad: 0.1_f64.to_radians(),
            bias_walk_rad_s: 0.005_f64.to_radians(),
        }
    }
}

/// The filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingFilter {
    noise: HeadingNoise,
    /// Heading and bias of the gyro.
    state: Vector2<f64>,
    covariance: Matrix2<f64>,
}

impl HeadingFilter {
    /// A filter that knows the heading exactly, as the frame begins with it, and nothing of the bias but its spread.
    #[must_use]
    pub fn new(noise: HeadingNoise, heading_rad: f64, bias_sigma_rad_s: f64) -> Self {
        let covariance = Matrix2::new(0.0, 0.0, 0.0, bias_sigma_rad_s * bias_sigma_rad_s);
        Self { noise, state: Vector2::new(heading_rad, 0.0), covariance }
    }

    /// Takes in `dt_s` in which the wheels say that the robot turned by `odometry_rad`, and the gyro by `gyro_rad`. A gyro that
    /// says nothing, or no number, leaves it to the wheels; what is no number of the wheels leaves everything as it is.
    pub fn advance(&mut self, odometry_rad: f64, gyro_rad: Option<f64>, dt_s: f64) {
        if !(odometry_rad.is_finite() && dt_s >= 0.0 && dt_s.is_finite()) {
            return;
        }
        let noise = self.noise;
        let wheels_rad2 = (noise.odometry_share * odometry_rad).powi(2) + noise.odometry_floor_rad.powi(2);
        self.covariance.m22 += noise.bias_walk_rad_s.powi(2) * dt_s;
        let Some(gyro_rad) = gyro_rad.filter(|turn_rad| turn_rad.is_finite()) else {
            self.state.x += odometry_rad;
            self.covariance.m11 += wheels_rad2;
            return;
        };
        // The turn by the gyro is gyro - bias dt - noise: it moves heading and covariance first, ...
        let [bias2, cross] = [self.covariance.m22, self.covariance.m12];
        let noise_rad2 = noise.gyro_rad.powi(2) * dt_s;
        let turn_rad = gyro_rad - self.state.y * dt_s;
        let turn_rad2 = bias2 * dt_s * dt_s + noise_rad2;
        // ... covariance of (heading, bias) after the turn with the turn itself, ...
        let with_turn = Vector2::new(turn_rad2 - cross * dt_s, -bias2 * dt_s);
        let heading2 = self.covariance.m11 - 2.0 * cross * dt_s + turn_rad2;
        let heading_bias = cross - bias2 * dt_s;
        self.covariance = Matrix2::new(heading2, heading_bias, heading_bias, bias2);
        self.state.x += turn_rad;
        // ... and the wheels measure the turn.
        let gain = with_turn / (turn_rad2 + wheels_rad2).max(f64::MIN_POSITIVE);
        self.state += gain * (odometry_rad - turn_rad);
        self.covariance -= gain * with_turn.transpose();
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }

    /// Heading, wrapped.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        wrap_angle_rad(self.state.x)
    }

    /// Standard deviation of the heading.
    #[must_use]
    pub fn heading_sigma_rad(&self) -> f64 {
        self.covariance.m11.max(0.0).sqrt()
    }

    /// What the gyro adds up in a second while the robot stands.
    #[must_use]
    pub fn bias_rad_s(&self) -> f64 {
        self.state.y
    }

    /// Standard deviation of that.
    #[must_use]
    pub fn bias_sigma_rad_s(&self) -> f64 {
        self.covariance.m22.max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    const BIAS_SIGMA_RAD_S: f64 = 0.01;

    /// Errors of filter, gyro and wheels after standing 2 s and turning 30 degrees in 4 s, three times, and the filter's own
    /// squared error over its variance.
    fn paper(random: &mut ChaCha8Rng) -> [f64; 4] {
        let noise = HeadingNoise::default();
        let bias_rad_s = BIAS_SIGMA_RAD_S * normal(random);
        let mut filter = HeadingFilter::new(noise, 0.0, BIAS_SIGMA_RAD_S);
        let (mut truth_rad, mut gyro_rad, mut wheels_rad) = (0.0, 0.0, 0.0);
        for _ in 0..3 {
            for (turn_rad, dt_s) in [(0.0, 2.0), (30f64.to_radians(), 4.0)] {
                let slip = (noise.odometry_share * turn_rad).hypot(noise.odometry_floor_rad) * normal(random);
                let heard = turn_rad + slip + bias_rad_s * dt_s + noise.gyro_rad * f64::sqrt(dt_s) * normal(random);
                filter.advance(turn_rad, Some(heard), dt_s);
                truth_rad += turn_rad + slip;
                gyro_rad += heard;
                wheels_rad += turn_rad;
            }
        }
        let error_rad = filter.heading_rad() - wrap_angle_rad(truth_rad);
        let squared = (error_rad / filter.heading_sigma_rad()).powi(2);
        [error_rad, gyro_rad - truth_rad, wheels_rad - truth_rad, squared]
    }

    #[test]
    fn the_filter_is_better_than_either_and_knows_how_good_it_is() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let runs: Vec<[f64; 4]> = (0..4000).map(|_| paper(&mut random)).collect();
        let mean = |of: fn(&[f64; 4]) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
        let [filter, gyro, wheels] =
            [mean(|run| run[0] * run[0]), mean(|run| run[1] * run[1]), mean(|run| run[2] * run[2])].map(f64::sqrt);
        assert!(filter < 0.7 * wheels && filter < 0.2 * gyro, "rms {filter} {gyro} {wheels} rad");
        let squared = mean(|run| run[3]);
        assert!((0.9..1.1).contains(&squared), "normalised squared error {squared}");
    }

    #[test]
    fn the_papers_six_degrees_are_found_while_the_robot_stands() {
        let noise = HeadingNoise::default();
        let bias_rad_s = (6.0_f64 / 19.0).to_radians();
        let mut filter = HeadingFilter::new(noise, 0.0, 0.01);
        for _ in 0..3 {
            filter.advance(0.0, Some(bias_rad_s * 2.0), 2.0);
            let dt_s = 13.0 / 3.0;
            filter.advance(30f64.to_radians(), Some(30f64.to_radians() + bias_rad_s * dt_s), dt_s);
        }
        let [found_deg, bias_deg_s] = [filter.heading_rad(), filter.bias_rad_s()].map(f64::to_degrees);
        assert!((found_deg - 90.0).abs() < 0.2, "{found_deg}");
        assert!((bias_deg_s - 6.0 / 19.0).abs() < 0.02, "{bias_deg_s}");
    }

    #[test]
    fn wheels_alone_are_followed_and_their_uncertainty_grows() {
        let mut filter = HeadingFilter::new(HeadingNoise::default(), 1.0, 0.01);
        filter.advance(0.5, None, 1.0);
        let once = filter.heading_sigma_rad();
        filter.advance(0.5, Some(f64::NAN), 1.0);
        assert!((filter.heading_rad() - 2.0).abs() < 1e-12);
        assert!((filter.heading_sigma_rad() - once * 2f64.sqrt()).abs() < 1e-9);
        let before = filter;
        filter.advance(f64::NAN, Some(0.1), 1.0);
        filter.advance(0.1, Some(0.1), f64::NAN);
        assert_eq!(filter, before);
    }
}
