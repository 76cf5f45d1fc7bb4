//! `[control]` of the configuration: thresholds, gains and regions of the layers.
//!
//! Energies are the gained envelope (linear amplitude in units of full scale, 1 m as reference; a wall at 1 m reads 0.1) or
//! sums of it, so a threshold here is an amplitude, for CA and E_ref times a number of cells. Where the numbers come from, and
//! why they hold for any sensor layout, is told in [`super::default_regions`]. This file decides nothing; it only refuses
//! values that make no sense.

use super::default_regions;
use super::platform::PlatformLimits;
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;
use crate::parameter::{ParameterError, check_positive, check_range};
use serde::{Deserialize, Serialize};

/// Largest energy that a threshold may ask for.
const ENERGY_MAX: f64 = 1e6;
/// Largest gain of a control law.
const GAIN_MAX: f64 = 100.0;
/// Most ping sets that a layer may wait before it fires or releases: one second at 10 Hz.
const COUNT_MAX: u32 = 10;

/// `[control]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlParams {
    /// Ping sets a second; the time step of rate limits, filters and counts.
    pub rate_hz: f64,
    /// CA.
    pub collision_avoidance: CollisionAvoidanceParams,
    /// OA.
    pub obstacle_avoidance: ObstacleAvoidanceParams,
    /// AFF.
    pub flow_following: FlowFollowingParams,
    /// RCF.
    pub corridor_following: CorridorFollowingParams,
    /// What counts as energy.
    pub energy: EnergyParams,
    /// How much of the way must be seen.
    pub coverage: CoverageParams,
    /// When the robot counts as stuck, and how it gets away.
    pub stuck: StuckParams,
    /// Room for what moves.
    pub movers: RoomParams,
}

/// `[control.collision_avoidance]`, paper 000, eq. 11.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionAvoidanceParams {
    /// Whether the layer exists.
    pub enabled: bool,
    /// Union of shapes in the robot frame.
    pub regions: Vec<Shape>,
    /// Fires when the sum of E|M| over all sensors is above this (T_CA). A pillar of 2 cm sums to twice the default in one sensor.
    /// Side lobes in the way ahead that sum to more make it count as unseen, echoes behind that do make it not free.
    pub threshold: f64,
    /// Lets go when the sum is not above this.
    pub release: f64,
    /// Ping sets above `threshold` before it fires.
    pub trigger_count: u32,
    /// Ping sets not above `release` before it lets go.
    pub release_count: u32,
    /// Turn rate away from the nearest reflection.
    pub omega_rad_s: f64,
    /// Reverse speed, as a magnitude.
    pub reverse_m_s: f64,
    /// The trigger in a row, counted from 1, from which it reverses.
    pub reverse_after: u32,
    /// Longest way that it reverses until the region was clear once.
    pub reverse_max_m: f64,
    /// Longest time that it reverses until the region was clear once.
    pub reverse_max_s: f64,
}

/// `[control.obstacle_avoidance]`, paper 000, eq. 12.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObstacleAvoidanceParams {
    /// Whether the layer exists.
    pub enabled: bool,
    /// Union of shapes in the robot frame.
    pub regions: Vec<Shape>,
    /// Fires when any cell's E|M| is above this (T_OA). A pillar of 2 cm reads 0.008.
    pub threshold: f64,
    /// Lets go when no cell is above this.
    pub release: f64,
    /// Ping sets above `threshold` before it fires.
    pub trigger_count: u32,
    /// Ping sets not above `release` before it lets go.
    pub release_count: u32,
    /// Gain of the turn rate, lambda_OA: rad/s for an obstacle at 1 m on one side.
    pub lambda: f64,
    /// Gain of the slow-down, mu_OA: 1 for the simulated robot, 0.1 for a Husky (paper 000), as lambda.
    pub mu: f64,
    /// Sum of E|M| that stops the robot at `mu = 1` (E_ref), for each sensor that hears anything: a layout of three sensors slows
    /// down as one of a single sensor does.
    pub energy_reference: f64,
}

/// `[control.corridor_following]`, paper 000, eq. 13.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CorridorFollowingParams {
    /// Whether the layer exists.
    pub enabled: bool,
    /// Union of shapes in the robot frame.
    pub regions: Vec<Shape>,
    /// Fires when any cell's E|M| is above this (T_RCF): for walls (0.09) and thick pillars, not for poles beside the way.
    pub threshold: f64,
    /// Lets go when no cell is above this.
    pub release: f64,
    /// Ping sets above `threshold` before it fires.
    pub trigger_count: u32,
    /// Ping sets not above `release` before it lets go.
    pub release_count: u32,
    /// Gain of the turn rate, lambda_RCF.
    pub lambda: f64,
}

/// `[control.flow_following]`, paper 000, eq. 14 to 16.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowFollowingParams {
    /// Whether the layer exists.
    pub enabled: bool,
    /// The flow lines.
    pub regions: Vec<FlowLinesRegion>,
    /// A single wall is followed when its Gamma is above this; a wall 0.8 m abeam has 0.0058.
    pub threshold_single: f64,
    /// A corridor is followed when Gamma of a wall on either side is above this; lower, since two walls speak for each other.
    pub threshold_corridor: f64,
    /// Share of a threshold that a wall may fall to before it is lost, 0 to 1.
    pub release_ratio: f64,
    /// Ping sets above a threshold before it fires.
    pub trigger_count: u32,
    /// Ping sets without a wall before it lets go.
    pub release_count: u32,
    /// By how much a peak of Gamma must stand out between its neighbours.
    pub prominence: f64,
    /// Least distance between two peaks.
    pub separation_m: f64,
    /// Gain of the turn rate, lambda_AFF.
    pub lambda: f64,
    /// Distance to keep from a single wall; without it the present distance is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub set_distance_m: Option<f64>,
    /// Time constant of the low-pass on the corridor law's derivative.
    pub derivative_filter_s: f64,
}

/// `[control.energy]`: the range gain and the noise floor that make an envelope an energy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnergyParams {
    /// Exponent p of the compensation of spreading, (r / 1 m)^p.
    pub spreading_exponent: f64,
    /// Absorption in dB per metre of path (the path is twice the range).
    pub absorption_db_m: f64,
    /// Noise floor of the envelope, before any gain, as `[range_m, dBFS]` points, ascending in range, linear in between, level
    /// outside. Higher near the sensor, where the direct path rings on.
    pub noise_floor_dbfs: Vec<[f64; 2]>,
    /// An echo this far below the loudest at its range, in any direction of the same sensor, may be that one's side lobe (some
    /// 10 dB down): it is left out of every region and flow line. Where one in the way ahead may hide something the way counts as
    /// unseen from there on. The larger, the more counts as an echo.
    pub side_lobe_db: f64,
}

/// `[control.coverage]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CoverageParams {
    /// Longest unseen stretch right at the footprint that counts as seen before: unseen is not free, but what is now too near to
    /// be heard was in view when the robot was farther back. The deaf 0.3 m in front of a sensor at the rim fit in.
    pub blind_gap_m: f64,
    /// Time from an obstacle's coming into view to the beginning of braking.
    pub reaction_s: f64,
}

/// `[control.stuck]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StuckParams {
    /// Whether it is looked for.
    pub enabled: bool,
    /// Time without progress while motion is asked for.
    pub time_s: f64,
    /// What counts as progress in that time.
    pub distance_m: f64,
    /// Angle of the first turn on the spot to get away.
    pub escape_turn_deg: f64,
}

/// `[control.movers]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomParams {
    /// Whether the robot slows down for what moves.
    pub enabled: bool,
    /// How far ahead movers and robot are thought on, straight.
    pub horizon_s: f64,
    /// Gap that is to be left between the footprint and a mover.
    pub gap_m: f64,
}

impl Default for ControlParams {
    fn default() -> Self {
        Self::for_platform(&PlatformLimits::default())
    }
}

impl ControlParams {
    /// Defaults with all regions fitted to a platform, by the rule of [`super::default_regions`].
    #[must_use]
    pub fn for_platform(platform: &PlatformLimits) -> Self {
        Self {
            rate_hz: 10.0,
            collision_avoidance: CollisionAvoidanceParams {
                regions: default_regions::collision_avoidance(platform),
                ..CollisionAvoidanceParams::without_regions()
            },
            obstacle_avoidance: ObstacleAvoidanceParams {
                regions: default_regions::obstacle_avoidance(platform),
                ..ObstacleAvoidanceParams::without_regions()
            },
            flow_following: FlowFollowingParams {
                regions: default_regions::flow_following(platform),
                ..FlowFollowingParams::without_regions()
            },
            corridor_following: CorridorFollowingParams {
                regions: default_regions::corridor_following(platform),
                ..CorridorFollowingParams::without_regions()
            },
            energy: EnergyParams::default(),
            coverage: CoverageParams::default(),
            stuck: StuckParams::default(),
            movers: RoomParams::default(),
        }
    }

    /// Fits the regions that are still those of the default platform to `platform`: what a configuration with a
    /// `[platform]` of its own and no regions means.
    pub fn fit_default_regions(&mut self, platform: &PlatformLimits) {
        let (default, fitted) = (Self::default(), Self::for_platform(platform));
        if self.collision_avoidance.regions == default.collision_avoidance.regions {
            self.collision_avoidance.regions = fitted.collision_avoidance.regions;
        }
        if self.obstacle_avoidance.regions == default.obstacle_avoidance.regions {
            self.obstacle_avoidance.regions = fitted.obstacle_avoidance.regions;
        }
        if self.flow_following.regions == default.flow_following.regions {
            self.flow_following.regions = fitted.flow_following.regions;
        }
        if self.corridor_following.regions == default.corridor_following.regions {
            self.corridor_following.regions = fitted.corridor_following.regions;
        }
    }

    /// Refuses values that make no sense. A zone shorter than the stopping distance is refused where platform and timeouts
    /// are known too, a region that no sensor sees where the masks are built.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[control]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_range("rate_hz", self.rate_hz, 1.0, 100.0)?;
        self.collision_avoidance.validate().map_err(|error| error.within("collision_avoidance"))?;
        self.obstacle_avoidance.validate().map_err(|error| error.within("obstacle_avoidance"))?;
        self.flow_following.validate().map_err(|error| error.within("flow_following"))?;
        self.corridor_following.validate().map_err(|error| error.within("corridor_following"))?;
        self.energy.validate().map_err(|error| error.within("energy"))?;
        check_range("coverage.blind_gap_m", self.coverage.blind_gap_m, 0.0, 2.0)?;
        check_range("coverage.reaction_s", self.coverage.reaction_s, 0.1, 2.0)?;
        check_range("stuck.time_s", self.stuck.time_s, 1.0, 600.0)?;
        check_positive("stuck.distance_m", self.stuck.distance_m, 10.0)?;
        check_range("stuck.escape_turn_deg", self.stuck.escape_turn_deg, 10.0, 180.0)?;
        check_range("movers.horizon_s", self.movers.horizon_s, 0.2, 10.0)?;
        check_range("movers.gap_m", self.movers.gap_m, 0.0, 2.0)
    }
}

impl CollisionAvoidanceParams {
    fn without_regions() -> Self {
        Self {
            enabled: true,
            regions: Vec::new(),
            threshold: 0.3,
            release: 0.15,
            trigger_count: 1,
            release_count: 3,
            omega_rad_s: 0.5,
            reverse_m_s: 0.1,
            reverse_after: 4,
            reverse_max_m: 0.5,
            reverse_max_s: 5.0,
        }
    }

    fn validate(&self) -> Result<(), ParameterError> {
        check_regions(self.enabled, &self.regions)?;
        check_hysteresis(self.threshold, self.release, self.trigger_count, self.release_count)?;
        check_positive("omega_rad_s", self.omega_rad_s, 10.0)?;
        check_range("reverse_m_s", self.reverse_m_s, 0.0, 1.0)?;
        check_count("reverse_after", self.reverse_after, 1, 1000)?;
        check_range("reverse_max_m", self.reverse_max_m, 0.0, 0.5)?;
        check_range("reverse_max_s", self.reverse_max_s, 0.0, 5.0)
    }
}

impl Default for CollisionAvoidanceParams {
    fn default() -> Self {
        ControlParams::default().collision_avoidance
    }
}

impl ObstacleAvoidanceParams {
    fn without_regions() -> Self {
        Self {
            enabled: true,
            regions: Vec::new(),
            threshold: 0.007,
            release: 0.0055,
            trigger_count: 2,
            release_count: 3,
            lambda: 1.0,
            mu: 1.0,
            energy_reference: 12.0,
        }
    }

    fn validate(&self) -> Result<(), ParameterError> {
        check_regions(self.enabled, &self.regions)?;
        check_hysteresis(self.threshold, self.release, self.trigger_count, self.release_count)?;
        check_range("lambda", self.lambda, 0.0, GAIN_MAX)?;
        check_range("mu", self.mu, 0.0, GAIN_MAX)?;
        check_positive("energy_reference", self.energy_reference, ENERGY_MAX)
    }
}

impl Default for ObstacleAvoidanceParams {
    fn default() -> Self {
        ControlParams::default().obstacle_avoidance
    }
}

impl CorridorFollowingParams {
    fn without_regions() -> Self {
        Self {
            enabled: true,
            regions: Vec::new(),
            threshold: 0.02,
            release: 0.012,
            trigger_count: 2,
            release_count: 3,
            lambda: 1.0,
        }
    }

    fn validate(&self) -> Result<(), ParameterError> {
        check_regions(self.enabled, &self.regions)?;
        check_hysteresis(self.threshold, self.release, self.trigger_count, self.release_count)?;
        check_range("lambda", self.lambda, 0.0, GAIN_MAX)
    }
}

impl Default for CorridorFollowingParams {
    fn default() -> Self {
        ControlParams::default().corridor_following
    }
}

impl FlowFollowingParams {
    fn without_regions() -> Self {
        Self {
            enabled: true,
            regions: Vec::new(),
            threshold_single: 4e-3,
            threshold_corridor: 3e-3,
            release_ratio: 0.6,
            trigger_count: 2,
            release_count: 3,
            prominence: 1e-3,
            separation_m: 0.2,
            lambda: 1.0,
            set_distance_m: None,
            derivative_filter_s: 0.2,
        }
    }

    fn validate(&self) -> Result<(), ParameterError> {
        if self.enabled && self.regions.is_empty() {
            return Err(ParameterError::new("regions", "no region", "at least one region, or enabled = false"));
        }
        for (index, region) in self.regions.iter().enumerate() {
            region.validate(&format!("regions[{index}]"))?;
        }
        check_positive("threshold_single", self.threshold_single, ENERGY_MAX)?;
        check_positive("threshold_corridor", self.threshold_corridor, ENERGY_MAX)?;
        check_range("release_ratio", self.release_ratio, 0.0, 1.0)?;
        check_count("trigger_count", self.trigger_count, 1, COUNT_MAX)?;
        check_count("release_count", self.release_count, 1, COUNT_MAX)?;
        check_range("prominence", self.prominence, 0.0, ENERGY_MAX)?;
        check_range("separation_m", self.separation_m, 0.0, 10.0)?;
        check_range("lambda", self.lambda, 0.0, GAIN_MAX)?;
        if let Some(distance_m) = self.set_distance_m {
            check_positive("set_distance_m", distance_m, 10.0)?;
        }
        check_range("derivative_filter_s", self.derivative_filter_s, 0.0, 10.0)
    }
}

impl Default for FlowFollowingParams {
    fn default() -> Self {
        ControlParams::default().flow_following
    }
}

impl Default for EnergyParams {
    fn default() -> Self {
        Self {
            spreading_exponent: 1.0,
            absorption_db_m: 1.2,
            noise_floor_dbfs: vec![[0.3, -60.0], [0.5, -70.0], [5.0, -70.0]],
            side_lobe_db: 8.0,
        }
    }
}

impl EnergyParams {
    /// The share of the loudest echo at its range, a factor, below which an echo may be a side lobe.
    #[must_use]
    pub fn side_lobe_share(&self) -> f64 {
        10f64.powf(-self.side_lobe_db / 20.0)
    }

    fn validate(&self) -> Result<(), ParameterError> {
        check_range("spreading_exponent", self.spreading_exponent, 0.0, 4.0)?;
        check_range("absorption_db_m", self.absorption_db_m, 0.0, 20.0)?;
        check_range("side_lobe_db", self.side_lobe_db, 0.0, 200.0)?;
        if self.noise_floor_dbfs.is_empty() {
            return Err(ParameterError::new("noise_floor_dbfs", "no point", "at least one [range_m, dBFS] point"));
        }
        for (index, [range_m, floor_dbfs]) in self.noise_floor_dbfs.iter().enumerate() {
            check_range(&format!("noise_floor_dbfs[{index}]"), *range_m, 0.0, 100.0)?;
            check_range(&format!("noise_floor_dbfs[{index}]"), *floor_dbfs, -200.0, 0.0)?;
        }
        match self.noise_floor_dbfs.windows(2).position(|pair| pair[1][0] <= pair[0][0]) {
            Some(index) => Err(ParameterError::new(
                format!("noise_floor_dbfs[{}]", index + 1),
                self.noise_floor_dbfs[index + 1][0],
                "ranges in ascending order",
            )),
            None => Ok(()),
        }
    }
}

impl Default for CoverageParams {
    fn default() -> Self {
        Self { blind_gap_m: 0.4, reaction_s: 0.35 }
    }
}

impl Default for RoomParams {
    fn default() -> Self {
        Self { enabled: false, horizon_s: 3.0, gap_m: 0.3 }
    }
}

impl Default for StuckParams {
    fn default() -> Self {
        Self { enabled: true, time_s: 3.0, distance_m: 0.15, escape_turn_deg: 90.0 }
    }
}

fn check_regions(enabled: bool, regions: &[Shape]) -> Result<(), ParameterError> {
    if enabled && regions.is_empty() {
        return Err(ParameterError::new("regions", "no region", "at least one region, or enabled = false"));
    }
    for (index, region) in regions.iter().enumerate() {
        region.validate(&format!("regions[{index}]"))?;
    }
    Ok(())
}

fn check_hysteresis(threshold: f64, release: f64, trigger: u32, let_go: u32) -> Result<(), ParameterError> {
    check_positive("threshold", threshold, ENERGY_MAX)?;
    check_range("release", release, 0.0, threshold)?;
    check_count("trigger_count", trigger, 1, COUNT_MAX)?;
    check_count("release_count", let_go, 1, COUNT_MAX)
}

fn check_count(key: &str, found: u32, min: u32, max: u32) -> Result<(), ParameterError> {
    if (min..=max).contains(&found) {
        Ok(())
    } else {
        Err(ParameterError::new(key, found, format!("a whole number from {min} to {max}")))
    }
}
