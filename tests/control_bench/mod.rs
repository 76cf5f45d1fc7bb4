//! A controller with a clock, and cues made by hand.
#![allow(dead_code, reason = "every test file uses another part")]

use noctule::control::{ControlParams, Controller, PlatformLimits};
use noctule::geometry::Pose2;
use noctule::signal::{
    CoverageCue, Cues, Decision, LayerCue, NearestReflection, SENSORS_MAX, SensorSums, Velocity, WallPeak, WallPeaks,
};
use noctule::time::Stamp;

pub const PERIOD_NS: u64 = 100_000_000;
pub const FORWARD: Velocity = Velocity { linear_m_s: 0.3, angular_rad_s: 0.0 };

/// A controller, its clock, and the cues it gets next.
pub struct Bench {
    pub controller: Controller,
    pub now: Stamp,
    pub cues: Cues,
}

impl Bench {
    pub fn new(change: impl FnOnce(&mut ControlParams)) -> Self {
        let mut params = ControlParams::default();
        // Most claims are about laws; counts have tests of their own.
        params.obstacle_avoidance.trigger_count = 1;
        params.corridor_following.trigger_count = 1;
        params.flow_following.trigger_count = 1;
        change(&mut params);
        params.validate().unwrap();
        let now = Stamp { boottime_ns: 1_000_000_000_000, wall_ns: 0 };
        let coverage = CoverageCue { ahead_m: 3.0, behind_m: 3.0 };
        let cues = Cues { sensors_used: [true; SENSORS_MAX], coverage, ..Cues::default() };
        Self { controller: Controller::new(&params, &PlatformLimits::default()), now, cues }
    }

    pub fn step(&mut self, wanted: Velocity) -> Decision {
        self.step_with(wanted, None)
    }

    pub fn step_with(&mut self, wanted: Velocity, odometry: Option<Pose2>) -> Decision {
        self.now = self.now.plus_ns(PERIOD_NS);
        self.cues.emitted_at = self.now;
        self.cues.sequence += 1;
        self.controller.step_with_odometry(self.now, &self.cues, wanted, odometry)
    }

    /// Steps until rate limits have no more to say; the last decision.
    pub fn settle(&mut self, wanted: Velocity) -> Decision {
        (0..15).map(|_| self.step(wanted)).last().unwrap()
    }
}

pub fn cue(energy: f32, turn: f32, peak: f32, side: i8) -> LayerCue {
    let nearest = NearestReflection {
        sensor_index: 1,
        range_m: 0.5,
        bearing_rad: 0.3,
        distance_m: 0.2,
        place_m: [0.4, 0.1 * f64::from(side)],
        energy: peak,
        side,
        lead_m: f64::INFINITY,
    };
    LayerCue {
        energy,
        turn,
        peak,
        sensors: [SensorSums::default(); SENSORS_MAX],
        nearest: (energy > 0.0).then_some(nearest),
    }
}

pub fn walls(found: &[(f64, f64)]) -> WallPeaks {
    let mut walls = WallPeaks { count: found.len(), ..WallPeaks::default() };
    for (slot, (lateral_m, strength)) in walls.peaks.iter_mut().zip(found) {
        *slot = WallPeak { lateral_m: *lateral_m, strength: *strength };
    }
    walls
}

pub fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
}
