//! What can be set about the simulation: the acoustics, the robot, and what a simulator refuses at start.
//!
//! Amplitudes are in units of full scale at the microphone. This file computes nothing.

use crate::parameter::{ParameterError, check_positive, check_range};
use crate::signal::SENSORS_MAX;

/// Most jammers.
pub const JAMMERS_MAX: usize = 4;

/// Acoustics and behaviour of the simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimParams {
    /// What a perfect plane at 1 m, on the emitter's axis, reads after a matched filter.
    pub plane_at_1_m: f64,
    /// Amplitude of a sensor's own direct path at its nearest microphone.
    pub direct_amplitude: f64,
    /// Standard deviation of each microphone's white noise.
    pub noise_rms: f64,
    /// Radius of the emitter, taken as a piston in a baffle.
    pub emitter_radius_m: f64,
    /// Real edges are rounded: an edge's echo is never weaker than that of a cylinder of this radius.
    pub edge_radius_m: f64,
    /// Bearing up to which emitter and microphones hear undiminished by their housing.
    pub view_full_rad: f64,
    /// Bearing beyond which they hear nothing; in between the gain falls smoothly.
    pub view_zero_rad: f64,
    /// The air; without it nothing is absorbed.
    pub air: Option<Air>,
    /// Whether sensors hear each other's emissions.
    pub cross_talk: bool,
    /// How late each sensor emits, and begins to record: its own echoes stay where they are, those of the others move.
    pub sync_offsets_s: [f64; SENSORS_MAX],
    /// Sensors that fire one after another; without it all fire at once.
    pub turns: Option<Turns>,
    /// Standard deviation of what comes on top of that, drawn for every ping and sensor.
    pub sync_jitter_s: f64,
    /// Sources of narrow-band ultrasound that are no sonar.
    pub jammers: [Option<Jammer>; JAMMERS_MAX],
    /// Whether objects, housings and obstructions hide what is behind them.
    pub occlusion: bool,
    /// Whether echoes are made too that come over two walls which do not meet in a corner, or over a wall and something
    /// round.
    pub multipath: bool,
    /// Whether the robot and the movers move on while the sound flies; if not, all stand still for the length of a ping.
    pub motion: bool,
    /// Echoes whose amplitude stays below this are left out.
    pub weakest_amplitude: f64,
    /// Relative standard deviation of the two wheels' diameters as odometry takes them; 0 = perfect odometry.
    pub odometry_drift: f64,
    /// Whether guidance starts again at the first waypoint after the last (for demonstrations).
    pub repeat_waypoints: bool,
}

/// A source of narrow-band ultrasound that is no sonar: a parking sensor, a switching supply, a leak of compressed air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jammer {
    /// Its frequency; below 0.4 of the demodulated rate.
    pub frequency_hz: f64,
    /// What a microphone that faces it hears at 1 m.
    pub amplitude_at_1_m: f64,
    /// Where it stands in the world: x, y and the height above the sensors' origins.
    pub position_m: [f64; 3],
    /// Bursts; without them it sounds all the time.
    pub bursts: Option<Bursts>,
}

/// When sensors fire that take turns: sensor k, k slots after the first one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turns {
    /// From one sensor's emission to the next one's.
    pub slot_s: f64,
    /// From one ping set to the next: what the set before sent is still heard.
    pub period_s: f64,
}

/// When a jammer sounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bursts {
    /// From one burst to the next.
    pub period_s: f64,
    /// Length of a burst; the first and the last tenth fade.
    pub duration_s: f64,
}

impl Jammer {
    fn validate(&self) -> Result<(), ParameterError> {
        check_positive("frequency_hz", self.frequency_hz, 1e6)?;
        check_range("amplitude_at_1_m", self.amplitude_at_1_m, 0.0, 100.0)?;
        for (axis, coordinate_m) in self.position_m.into_iter().enumerate() {
            check_range(&format!("position_m[{axis}]"), coordinate_m, -1e4, 1e4)?;
        }
        if let Some(bursts) = self.bursts {
            check_positive("bursts.period_s", bursts.period_s, 1e3)?;
            check_positive("bursts.duration_s", bursts.duration_s, bursts.period_s)?;
        }
        Ok(())
    }
}

/// State of the air, for its absorption.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Temperature.
    pub temperature_c: f64,
    /// Relative humidity.
    pub humidity_percent: f64,
    /// Pressure.
    pub pressure_kpa: f64,
}

impl Default for Air {
    fn default() -> Self {
        Self { temperature_c: 20.0, humidity_percent: 50.0, pressure_kpa: 101.325 }
    }
}

impl Default for SimParams {
    fn default() -> Self {
        Self {
            plane_at_1_m: 0.1,
            direct_amplitude: 0.7,
            noise_rms: 1e-3,
            emitter_radius_m: 2e-3,
            edge_radius_m: 2e-3,
            view_full_rad: 80f64.to_radians(),
            view_zero_rad: 100f64.to_radians(),
            air: Some(Air::default()),
            cross_talk: true,
            sync_offsets_s: [0.0; SENSORS_MAX],
            turns: None,
            // The sensors of paper 000 are synchronised to 400 ns.
            sync_jitter_s: 2e-7,
            jammers: [None; JAMMERS_MAX],
            occlusion: true,
            multipath: false,
            motion: true,
            weakest_amplitude: 3e-6,
            odometry_drift: 0.0,
            repeat_waypoints: false,
        }
    }
}

impl SimParams {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_range("plane_at_1_m", self.plane_at_1_m, 0.0, 10.0)?;
        check_range("direct_amplitude", self.direct_amplitude, 0.0, 10.0)?;
        check_range("noise_rms", self.noise_rms, 0.0, 1.0)?;
        check_range("emitter_radius_m", self.emitter_radius_m, 0.0, 0.05)?;
        check_range("edge_radius_m", self.edge_radius_m, 0.0, 0.1)?;
        check_range("view_full_rad", self.view_full_rad, 0.0, std::f64::consts::PI)?;
        check_range("view_zero_rad", self.view_zero_rad, self.view_full_rad, std::f64::consts::PI)?;
        if let Some(air) = self.air {
            check_range("air.temperature_c", air.temperature_c, -40.0, 60.0)?;
            check_range("air.humidity_percent", air.humidity_percent, 1.0, 100.0)?;
            check_range("air.pressure_kpa", air.pressure_kpa, 20.0, 120.0)?;
        }
        for (sensor, offset_s) in self.sync_offsets_s.into_iter().enumerate() {
            check_range(&format!("sync_offsets_s[{sensor}]"), offset_s, -0.1, 0.1)?;
        }
        if let Some(turns) = self.turns {
            check_positive("turns.slot_s", turns.slot_s, 10.0)?;
            check_range("turns.period_s", turns.period_s, turns.slot_s, 100.0)?;
        }
        check_range("sync_jitter_s", self.sync_jitter_s, 0.0, 0.1)?;
        for (index, jammer) in self.jammers.iter().enumerate() {
            if let Some(jammer) = jammer {
                jammer.validate().map_err(|error| error.within(&format!("jammers[{index}]")))?;
            }
        }
        check_range("weakest_amplitude", self.weakest_amplitude, 0.0, 1.0)?;
        check_range("odometry_drift", self.odometry_drift, 0.0, 0.5)
    }
}

/// What the platform can do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Highest forward or backward speed.
    pub max_linear_m_s: f64,
    /// Highest turn rate.
    pub max_angular_rad_s: f64,
    /// Highest rate of change of the speed.
    pub max_linear_accel_m_s2: f64,
    /// Highest rate of change of the turn rate.
    pub max_angular_accel_rad_s2: f64,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self { max_linear_m_s: 0.3, max_angular_rad_s: 1.0, max_linear_accel_m_s2: 1.0, max_angular_accel_rad_s2: 3.0 }
    }
}

/// The robot's body: a disc around its centre of rotation, driven by two wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotParams {
    /// Radius of the disc.
    pub radius_m: f64,
    /// Its lowest and highest part above the plane of the sensors' origins; without them it reaches from the floor to the ceiling.
    pub z_m: Option<[f64; 2]>,
    /// What it can do.
    pub limits: MotionLimits,
}

impl Default for RobotParams {
    fn default() -> Self {
        Self { radius_m: 0.2, z_m: None, limits: MotionLimits::default() }
    }
}

impl RobotParams {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_positive("radius_m", self.radius_m, 10.0)?;
        if let Some([low_m, high_m]) = self.z_m.filter(|[low_m, high_m]| !(low_m < high_m)) {
            return Err(ParameterError::new("z_m", format!("[{low_m}, {high_m}]"), "a lowest and a higher height"));
        }
        check_positive("max_linear_m_s", self.limits.max_linear_m_s, 20.0)?;
        check_positive("max_angular_rad_s", self.limits.max_angular_rad_s, 20.0)?;
        check_positive("max_linear_accel_m_s2", self.limits.max_linear_accel_m_s2, 100.0)?;
        check_positive("max_angular_accel_rad_s2", self.limits.max_angular_accel_rad_s2, 100.0)
    }
}

/// Why a simulator cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A value of the world, the robot or the simulation.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The sensors and the recording do not fit each other or the simulator.
    #[error("sensor {sensor}: {what}: found {found}, allowed: {allowed}")]
    Sensor {
        /// Name of the sensor.
        sensor: String,
        /// What does not fit.
        what: &'static str,
        /// The value found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// No place in the start zone is free.
    #[error("the start zone leaves no room for the robot: {tries} random places all touch something")]
    NoRoomAtStart {
        /// How many places were tried.
        tries: usize,
    },
}
