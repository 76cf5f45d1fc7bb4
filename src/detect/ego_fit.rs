//! The corrected flow field turned round: how the robot moves, from how echoes move (specification, section 4).
//!
//! Goes in: for each reflector the rates of its range and bearing with their uncertainties. Comes out: V and omega with covariance,
//! and which reflectors agree. The field is linear in both, so two rates make a candidate: the candidate that most rates agree with is
//! refined by weighted least squares with Tukey's weights. Knows no images, no tracks and no odometry.
//!
//! # What slides
//!
//! The field is that of a point. A smooth specular surface is heard where its normal meets the sensor, and that place wanders over the
//! surface as the sensor moves. To first order only the centre of curvature stays: the sensor sees the surface along the line to that
//! centre, at a range R less. So with the radius of curvature R (0 for a point, an edge or a corner; the radius of a pillar; infinite for
//! a wall) and u = V sin(theta + delta) - l omega cos(theta + beta), the sensor's speed across the line of sight,
//!
//! ```text
//! dr/dt     = -V cos(theta + delta) - l omega sin(theta + beta)     whatever R
//! dtheta/dt = kappa u - omega,   kappa = 1 / (r + R) in [0, 1/r]    a wall's bearing only turns, by -omega
//! ```
//!
//! Range rates therefore count as they are, bearing rates with kappa as a nuisance between 0 and 1/r: its uncertainty times u
//! joins that of the rate. A robot that only turns has u near 0, and all bearings tell omega.

use crate::sensor::Mount;
use crate::signal::Velocity;
use nalgebra::{Matrix2, Vector2};

/// Most reflectors that a fit looks at.
pub const RATES_MAX: usize = 64;
/// Reflectors of which pairs are made.
const PAIRED_MAX: usize = 14;
/// Reflectors nearer together are one thing.
const ONE_THING_M: f64 = 0.6;
/// Where a rate stops to count, in standard deviations.
const TUKEY: f64 = 4.0;
/// Within so many a reflector agrees.
const AGREES: f64 = 3.0;
const ROUNDS: usize = 12;
/// Standard deviation of a range rate beyond what its ranges explain: tops of neighbouring hills pull at each other.
const RANGE_RATE_FLOOR_M_S: f64 = 0.004;
/// The same of a bearing rate.
const BEARING_RATE_FLOOR_RAD_S: f64 = 0.01;
/// How much faster than the platform is allowed to be a robot may be pushed.
const BEYOND: f64 = 1.25;
/// How much wider the covariance is told of n reflectors that agree: 1 + FEW / n^3.
const FEW: f64 = 64.0;
/// Rates that speak for a scale of 1 before any was seen: few residuals tell little of their own size.
const SCALE_PRIOR: f64 = 8.0;

/// How one reflector moved through a sensor's image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReflectorRate {
    /// The sensor.
    pub mount: Mount,
    /// Range, at the middle of the interval.
    pub range_m: f64,
    /// Bearing, at the middle of the interval.
    pub bearing_rad: f64,
    /// Rate of the range.
    pub range_rate_m_s: f64,
    /// Rate of the bearing.
    pub bearing_rate_rad_s: f64,
    /// Standard deviation of the range's rate.
    pub range_rate_sigma_m_s: f64,
    /// Standard deviation of the bearing's rate.
    pub bearing_rate_sigma_rad_s: f64,
    /// Standard deviation of the bearing itself.
    pub bearing_sigma_rad: f64,
    /// What is known of kappa, in 1/m: mean and standard deviation.
    pub bend: [f64; 2],
}

/// What is known of kappa of something of which nothing is known: even between a wall's and a point's.
#[must_use]
pub fn unknown_bend(range_m: f64) -> [f64; 2] {
    [0.5 / range_m, 1.0 / (12f64.sqrt() * range_m)]
}

/// What came out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EgoFit {
    /// V and omega.
    pub velocity: Velocity,
    /// Their covariance.
    pub covariance: Matrix2<f64>,
    /// Reflectors whose range rate agrees.
    pub inliers: usize,
}

/// One linear equation.
#[derive(Debug, Clone, Copy)]
struct Row {
    factors: Vector2<f64>,
    rate: f64,
    sigma: f64,
}

impl Row {
    /// Residual in standard deviations.
    fn off(&self, at: &Vector2<f64>) -> f64 {
        (self.rate - self.factors.dot(at)) / self.sigma
    }
}

/// A reflector's equations without their uncertainties, which depend on the velocity.
#[derive(Debug, Clone, Copy)]
struct Equations {
    along: Vector2<f64>,
    across: Vector2<f64>,
    rate: ReflectorRate,
    /// Place in the robot frame.
    place_m: Vector2<f64>,
}

impl Equations {
    fn new(rate: &ReflectorRate) -> Self {
        let (sin, cos) = rate.bearing_rad.sin_cos();
        let sensor = |velocity: Velocity| rate.mount.sensor_velocity_m_s(velocity);
        let drive = sensor(Velocity::forward_m_s(1.0));
        let turn = sensor(Velocity { linear_m_s: 0.0, angular_rad_s: 1.0 });
        let (ahead, left) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        Self {
            along: -Vector2::new(drive.dot(&ahead), turn.dot(&ahead)),
            across: -Vector2::new(drive.dot(&left), turn.dot(&left)),
            rate: *rate,
            place_m: rate.mount.pose().parent_from_local(rate.range_m * ahead),
        }
    }

    /// Range and bearing as equations near a velocity that is known with `spread`. A bearing tells omega alone: how far it slid is taken
    /// from the velocity, since all walls around being walls is no accident that could be averaged out.
    fn rows(&self, at: &Vector2<f64>, spread: &Matrix2<f64>) -> [Row; 2] {
        let rate = &self.rate;
        let across_m_s = self.across.dot(at);
        let [bend, bend_sigma] = rate.bend;
        let across_variance = (spread * self.across).dot(&self.across);
        let slid =
            bend_sigma * bend_sigma * (across_m_s * across_m_s + across_variance) + bend * bend * across_variance;
        let ranging = rate.range_rate_sigma_m_s.hypot(RANGE_RATE_FLOOR_M_S).hypot(across_m_s * rate.bearing_sigma_rad);
        let turning = rate.bearing_rate_sigma_rad_s.hypot(BEARING_RATE_FLOOR_RAD_S).hypot(slid.sqrt());
        [
            Row { factors: self.along, rate: rate.range_rate_m_s, sigma: ranging },
            Row { factors: Vector2::new(0.0, -1.0), rate: rate.bearing_rate_rad_s - bend * across_m_s, sigma: turning },
        ]
    }
}

/// Fits with memory of its own; allocates nothing after it was made.
#[derive(Debug, Clone)]
pub struct EgoFitter {
    equations: Vec<Equations>,
    /// Largest V and omega of the platform: what is known without any echo.
    limits: Vector2<f64>,
}

impl EgoFitter {
    /// A fitter for a platform that drives and turns no faster than this.
    #[must_use]
    pub fn new(max_linear_m_s: f64, max_angular_rad_s: f64) -> Self {
        Self { equations: Vec::with_capacity(RATES_MAX), limits: Vector2::new(max_linear_m_s, max_angular_rad_s) }
    }

    /// The velocity that most of `rates` agree with. Without a rate it is zero, as uncertain as the platform is fast. What is beyond
    /// [`RATES_MAX`] and what is no number is left out.
    pub fn fit(&mut self, rates: &[ReflectorRate]) -> EgoFit {
        self.equations.clear();
        let sound = |rate: &&ReflectorRate| {
            let numbers = [rate.range_m, rate.bearing_rad, rate.range_rate_m_s, rate.bearing_rate_rad_s];
            let sigmas =
                [rate.range_rate_sigma_m_s, rate.bearing_rate_sigma_rad_s, rate.bearing_sigma_rad, rate.bend[1]];
            numbers.iter().chain(&sigmas).chain(&rate.bend).all(|number| number.is_finite())
        };
        self.equations.extend(rates.iter().filter(sound).take(RATES_MAX).map(Equations::new));
        let start = self.best_candidate();
        self.refine(start)
    }

    /// Sum of squared residuals, each no more than it may count.
    fn cost(&self, at: &Vector2<f64>) -> f64 {
        let beyond = at.component_div(&self.limits);
        let rows = self.equations.iter().flat_map(|equations| equations.rows(at, &Matrix2::zeros()));
        rows.map(|row| row.off(at).powi(2).min(TUKEY * TUKEY)).sum::<f64>() + beyond.norm_squared()
    }

    fn best_candidate(&self) -> Vector2<f64> {
        let mut best = (self.cost(&Vector2::zeros()), Vector2::zeros());
        let paired = &self.equations[..self.equations.len().min(PAIRED_MAX)];
        for (index, one) in paired.iter().enumerate() {
            for (other_index, other) in paired.iter().enumerate() {
                // With u unknown a bearing counts with what is known of kappa alone.
                let [ranging, _] = one.rows(&Vector2::zeros(), &Matrix2::zeros());
                let [other_ranging, other_turning] = other.rows(&Vector2::zeros(), &Matrix2::zeros());
                let seconds = [Some(other_turning), (other_index > index).then_some(other_ranging)];
                for second in seconds.into_iter().flatten() {
                    let factors = Matrix2::from_rows(&[ranging.factors.transpose(), second.factors.transpose()]);
                    let Some(inverse) = factors.try_inverse() else { continue };
                    let at = inverse * Vector2::new(ranging.rate, second.rate);
                    // Beyond the platform's speeds it is somebody else's motion.
                    if !(at.x.abs() <= BEYOND * self.limits.x && at.y.abs() <= BEYOND * self.limits.y) {
                        continue;
                    }
                    let cost = self.cost(&at);
                    if cost < best.0 {
                        best = (cost, at);
                    }
                }
            }
        }
        best.1
    }

    fn refine(&self, start: Vector2<f64>) -> EgoFit {
        let widest = Matrix2::from_diagonal(&self.limits.component_mul(&self.limits));
        let prior = Matrix2::from_diagonal(&self.limits.map(|limit| 1.0 / (limit * limit)));
        let (mut at, mut spread, mut scale) = (start, widest, 1.0);
        for _ in 0..ROUNDS {
            let mut normal = prior;
            let mut right = Vector2::zeros();
            let (mut squares, mut count) = (0.0, 0.0);
            for row in self.equations.iter().flat_map(|equations| equations.rows(&at, &spread)) {
                let share = row.off(&at) / TUKEY;
                if !(share.abs() < 1.0) {
                    continue;
                }
                let weight = (1.0 - share * share).powi(2);
                let per = weight / (row.sigma * row.sigma);
                normal += per * row.factors * row.factors.transpose();
                right += per * row.rate * row.factors;
                squares += weight * row.off(&at).powi(2);
                count += weight;
            }
            scale = ((SCALE_PRIOR + squares) / (SCALE_PRIOR + count - 2.0).max(1.0)).max(1.0);
            let Some(inverse) = normal.try_inverse() else { break };
            let next = inverse * right;
            let step = (next - at).component_div(&self.limits).norm();
            (at, spread) = (next, inverse);
            if step < 1e-6 {
                break;
            }
        }
        let spread = self.without_any_one(&at, &spread);
        let agrees = |equations: &&Equations| equations.rows(&at, &spread)[0].off(&at).abs() <= AGREES;
        let inliers = self.equations.iter().filter(agrees).count();
        // Two reflectors that agree may do so by chance.
        let few = 1.0 + FEW / inliers.max(1).pow(3) as f64;
        EgoFit {
            velocity: Velocity { linear_m_s: at.x, angular_rad_s: at.y },
            covariance: spread * scale * few,
            inliers,
        }
    }
}

impl EgoFitter {
    /// The covariance if the thing that tells most were left out. It may be the one that moves: then nothing else contradicts it, and
    /// what it tells is its own motion. Reflectors that stand together are one thing, whichever sensor heard them.
    fn without_any_one(&self, at: &Vector2<f64>, spread: &Matrix2<f64>) -> Matrix2<f64> {
        let prior = Matrix2::from_diagonal(&self.limits.map(|limit| 1.0 / (limit * limit)));
        let told = |equations: &Equations| {
            let rows = equations.rows(at, spread).map(|row| {
                let share = row.off(at) / TUKEY;
                let weight = if share.abs() < 1.0 { (1.0 - share * share).powi(2) } else { 0.0 };
                weight / (row.sigma * row.sigma) * row.factors * row.factors.transpose()
            });
            rows[0] + rows[1]
        };
        let all = self.equations.iter().map(told).fold(prior, |sum, told| sum + told);
        let width = |covariance: &Matrix2<f64>| {
            covariance.m11 / (self.limits.x * self.limits.x) + covariance.m22 / (self.limits.y * self.limits.y)
        };
        let mut widest = *spread;
        for one in &self.equations {
            let near = |other: &&Equations| (other.place_m - one.place_m).norm() < ONE_THING_M;
            let without = self.equations.iter().filter(near).map(told).fold(all, |sum, told| sum - told);
            if let Some(covariance) = without.try_inverse().filter(|covariance| width(covariance) > width(&widest)) {
                widest = covariance;
            }
        }
        widest
    }
}

/// What a range rate and a bearing rate should be at a velocity: range rate, bearing rate without the slide (a wall's), and
/// the speed u across the line of sight.
#[must_use]
pub fn expected(mount: &Mount, velocity: Velocity, bearing_rad: f64) -> [f64; 3] {
    let (sin, cos) = bearing_rad.sin_cos();
    let sensor_m_s = mount.sensor_velocity_m_s(velocity);
    [-sensor_m_s.dot(&Vector2::new(cos, sin)), -velocity.angular_rad_s, -sensor_m_s.dot(&Vector2::new(-sin, cos))]
}
