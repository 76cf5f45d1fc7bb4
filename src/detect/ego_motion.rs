//! Ego-motion from acoustic flow, as it runs beside the controller: V and omega by the echoes alone, an alarm where odometry
//! contradicts them, and what moves beside the robot.
//!
//! Goes in: the energyscapes of a ping set and where odometry says it was made. Comes out: [`EgoMotionReport`], of fixed size. The way:
//! [`super::reflectors`] finds hills in each image, [`super::ego_tracks`] finds them again and follows them, [`super::ego_fit`] turns the
//! flow field round, [`super::slip`] compares with odometry. Commands nothing, reads no clock, allocates nothing after it was made.

use super::ego_fit::{EgoFit, EgoFitter, RATES_MAX, ReflectorRate};
use super::ego_tracks::{EgoTracks, Step};
use super::reflectors::{REFLECTORS_MAX, Reflector, ReflectorFinder};
use super::slip::{SlipMonitor, odometry_covariance, squared_distance};
use crate::geometry::{Pose2, wrap_angle_rad};
use crate::sensor::{Mount, SensorSetup};
use crate::signal::{EgoMotionReport, PolarGrid, Velocity};
use crate::time::Stamp;
use nalgebra::{Matrix2, Vector2};

/// Between two ping sets no less and no more time passes; otherwise everything begins anew.
const INTERVAL_S: [f64; 2] = [0.01, 0.45];
/// Standard deviations at which V and omega count as observed.
const OBSERVED_M_S: f64 = 0.05;
const OBSERVED_RAD_S: f64 = 0.1;
/// Squared distance from odometry up to which both are believed.
const AGREES: f64 = 9.0;

/// The robot as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EgoPlatform {
    /// Radius of the footprint.
    pub radius_m: f64,
    /// Largest speed.
    pub max_linear_m_s: f64,
    /// Largest turn rate.
    pub max_angular_rad_s: f64,
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
}

#[derive(Debug, Clone)]
struct Ear {
    finder: ReflectorFinder,
    reflectors: Vec<Reflector>,
    heard: bool,
}

/// Estimates the robot's motion, a ping set at a time.
#[derive(Debug, Clone)]
pub struct EgoMotion {
    platform: EgoPlatform,
    ears: Vec<Ear>,
    tracks: EgoTracks,
    fitter: EgoFitter,
    rates: Vec<ReflectorRate>,
    slip: SlipMonitor,
    last: Option<(u64, Option<Pose2>)>,
    report: EgoMotionReport,
}

impl EgoMotion {
    /// Knows nothing yet. The arguments are those of [`super::ScanFuser::new`], and the robot.
    #[must_use]
    pub fn new(
        grid: &PolarGrid,
        sensors: &[SensorSetup],
        hidden: &[Vec<bool>],
        floor_at: impl Fn(f64) -> f64,
        side_lobe_share: f64,
        platform: EgoPlatform,
    ) -> Self {
        let ear = |index: usize| Ear {
            finder: ReflectorFinder::new(
                grid,
                hidden.get(index).map_or(&[], Vec::as_slice),
                &floor_at,
                side_lobe_share,
            ),
            reflectors: Vec::with_capacity(REFLECTORS_MAX),
            heard: false,
        };
        let mounts: Vec<Mount> = sensors.iter().map(|sensor| sensor.mount).collect();
        Self {
            platform,
            ears: (0..sensors.len()).map(ear).collect(),
            tracks: EgoTracks::new(mounts, platform.speed_of_sound_m_s),
            fitter: EgoFitter::new(platform.max_linear_m_s, platform.max_angular_rad_s),
            rates: Vec::with_capacity(RATES_MAX),
            slip: SlipMonitor::default(),
            last: None,
            report: EgoMotionReport::default(),
        }
    }

    /// Takes the cells of a sensor's energyscape, wherever they lie. A sensor that is not there is ignored.
    pub fn hear(&mut self, sensor_index: usize, cells: &[f32]) {
        if let Some(ear) = self.ears.get_mut(sensor_index) {
            ear.finder.find(cells, &mut ear.reflectors);
            ear.heard = true;
        }
    }

    /// As [`EgoMotion::hear`], with reflectors that were found elsewhere.
    pub fn hear_reflectors(&mut self, sensor_index: usize, reflectors: &[Reflector]) {
        if let Some(ear) = self.ears.get_mut(sensor_index) {
            ear.reflectors.clear();
            ear.reflectors.extend(reflectors.iter().take(REFLECTORS_MAX));
            ear.heard = true;
        }
    }

    /// What was heard since the last call was emitted at `emitted_at`, the robot then at `odometry` by its wheels.
    pub fn update(&mut self, sequence: u64, emitted_at: Stamp, odometry: Option<Pose2>) -> &EgoMotionReport {
        let odometry = odometry.filter(|pose| [pose.x_m, pose.y_m, pose.heading_rad].iter().all(|n| n.is_finite()));
        let before = self.last.replace((emitted_at.boottime_ns, odometry));
        let interval_s = before.map_or(0.0, |(ns, _)| emitted_at.boottime_ns.saturating_sub(ns) as f64 * 1e-9);
        let known = self.report;
        self.report = EgoMotionReport { sequence, emitted_at, interval_s, ..EgoMotionReport::default() };
        if !(INTERVAL_S[0]..=INTERVAL_S[1]).contains(&interval_s) {
            self.begin_anew();
            return &self.report;
        }
        let wheels = before.and_then(|(_, pose)| Some(velocity_between(&pose?, &odometry?, interval_s)));
        let wheels = wheels.filter(|velocity| self.is_possible(*velocity));
        let trusted = !self.slip.is_raised() && known.innovation <= AGREES;
        let fit = self.fit(wheels.filter(|_| trusted), wheels.unwrap_or(known.velocity), known.velocity, interval_s);
        let fit = self.at_emission(fit, &known);
        let report = &mut self.report;
        report.velocity = fit.velocity;
        report.covariance = fit.covariance;
        let sigma = [fit.covariance.m11.sqrt(), fit.covariance.m22.sqrt()];
        report.observed = [sigma[0] <= OBSERVED_M_S, sigma[1] <= OBSERVED_RAD_S];
        (report.matched, report.inliers) = (self.rates.len(), fit.inliers);
        report.odometry = wheels;
        if let Some(wheels) = wheels {
            report.innovation = squared_distance(pair(fit.velocity), &fit.covariance, pair(wheels));
            // A velocity that less than half of the reflectors agree with may be that of somebody who walks by.
            let believed = 2 * fit.inliers > self.rates.len();
            report.slip = self.slip.observe(if believed { report.innovation } else { f64::NAN });
        }
        let step = self.believed_step(interval_s);
        self.tracks.advance(&step);
        for (sensor, ear) in self.ears.iter_mut().enumerate() {
            if std::mem::take(&mut ear.heard) {
                self.tracks.hear(sensor, &ear.reflectors, &step, &fit);
            } else {
                self.tracks.skip(sensor);
            }
        }
        self.report.movers = self.tracks.movers(self.platform.radius_m, step.velocity);
        &self.report
    }

    /// What was said last.
    #[must_use]
    pub fn report(&self) -> &EgoMotionReport {
        &self.report
    }

    fn begin_anew(&mut self) {
        self.tracks.clear();
        self.slip = SlipMonitor::default();
        let nothing = Step { velocity: Velocity::ZERO, covariance: Matrix2::zeros(), interval_s: 0.1 };
        let fit = self.fitter.fit(&[]);
        for (sensor, ear) in self.ears.iter_mut().enumerate().filter(|(_, ear)| ear.heard) {
            ear.heard = false;
            self.tracks.hear(sensor, &ear.reflectors, &nothing, &fit);
        }
    }

    /// Finds all reflectors again, about where `trusted` says, and fits. If that is nothing, where the one or the other guess finds
    /// more that agrees: reflectors that stand like the slats of a fence are else found one slat farther, ping set after ping set.
    fn fit(&mut self, trusted: Option<Velocity>, one: Velocity, other: Velocity, interval_s: f64) -> EgoFit {
        let step = |velocity| Step { velocity, covariance: Matrix2::zeros(), interval_s };
        self.match_all(&step(trusted.unwrap_or(one)));
        let first = self.fitter.fit(&self.rates);
        if trusted.is_some() || one == other {
            return first;
        }
        self.match_all(&step(other));
        let second = self.fitter.fit(&self.rates);
        if second.inliers >= first.inliers {
            return second;
        }
        self.match_all(&step(one));
        first
    }

    /// Finds all reflectors again.
    fn match_all(&mut self, guess: &Step) {
        self.rates.clear();
        for (sensor, ear) in self.ears.iter().enumerate().filter(|(_, ear)| ear.heard) {
            self.tracks.match_sensor(sensor, &ear.reflectors, guess);
        }
        let with_movers = !self.tracks.movers_are_few();
        for (sensor, ear) in self.ears.iter().enumerate().filter(|(_, ear)| ear.heard) {
            self.tracks.rates(sensor, &ear.reflectors, (guess.interval_s, with_movers), &mut self.rates);
        }
    }

    /// What was fitted is the mean velocity between the moments of hearing: a range is that of the time r/c after the emission, a bearing
    /// of 2r/c after it. As long as the velocity changes as it did, this is what it was between the emissions.
    fn at_emission(&self, fit: EgoFit, known: &EgoMotionReport) -> EgoFit {
        let mut fit = fit;
        if self.rates.is_empty() || !(known.interval_s > 0.0) || !(known.observed[0] && known.observed[1]) {
            return fit;
        }
        let mean_m = self.rates.iter().map(|rate| rate.range_m).sum::<f64>() / self.rates.len() as f64;
        let late = mean_m / (self.platform.speed_of_sound_m_s * known.interval_s);
        let change = pair(fit.velocity) - pair(known.velocity);
        let back = change.component_mul(&Vector2::new(late, 2.0 * late));
        fit.velocity.linear_m_s -= back.x;
        fit.velocity.angular_rad_s -= back.y;
        fit.covariance += Matrix2::from_diagonal(&back.component_mul(&back));
        fit
    }

    /// The best that is known of the step: echoes and wheels together while they agree, else the echoes.
    fn believed_step(&self, interval_s: f64) -> Step {
        let report = &self.report;
        let echoes = Step { velocity: report.velocity, covariance: report.covariance, interval_s };
        let Some(wheels) = report.odometry.filter(|_| !report.slip && report.innovation <= AGREES) else {
            return echoes;
        };
        let covariance = odometry_covariance(pair(wheels));
        let (Some(by_echoes), Some(by_wheels)) = (report.covariance.try_inverse(), covariance.try_inverse()) else {
            return echoes;
        };
        let Some(covariance) = (by_echoes + by_wheels).try_inverse() else { return echoes };
        let mean = covariance * (by_echoes * pair(report.velocity) + by_wheels * pair(wheels));
        Step { velocity: Velocity { linear_m_s: mean.x, angular_rad_s: mean.y }, covariance, interval_s }
    }

    /// Odometry that says what no such robot does has jumped.
    fn is_possible(&self, velocity: Velocity) -> bool {
        velocity.linear_m_s.abs() <= 3.0 * self.platform.max_linear_m_s
            && velocity.angular_rad_s.abs() <= 3.0 * self.platform.max_angular_rad_s
    }
}

fn pair(velocity: Velocity) -> Vector2<f64> {
    Vector2::new(velocity.linear_m_s, velocity.angular_rad_s)
}

/// The constant velocity on the arc from one pose to another.
#[must_use]
pub fn velocity_between(before: &Pose2, after: &Pose2, interval_s: f64) -> Velocity {
    let turn_rad = wrap_angle_rad(after.heading_rad - before.heading_rad);
    let half_rad = 0.5 * turn_rad;
    let (sin, cos) = (before.heading_rad + half_rad).sin_cos();
    let chord_m = (after.position_m() - before.position_m()).dot(&Vector2::new(cos, sin));
    let arc = if half_rad.abs() < 1e-9 { 1.0 } else { half_rad / half_rad.sin() };
    Velocity { linear_m_s: chord_m * arc / interval_s, angular_rad_s: turn_rad / interval_s }
}
