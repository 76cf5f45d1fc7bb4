//! Cues: the fused sums that the layers of the controller need, and nothing else.

use super::SENSORS_MAX;
use crate::time::Stamp;

/// Most walls that one ping set reports.
pub const WALL_PEAKS_MAX: usize = 8;

/// One sensor's part of a layer's cue.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorSums {
    /// Sum of E|M|.
    pub energy: f32,
    /// Sum of E M / r^2.
    pub turn: f32,
    /// Largest E in the region.
    pub peak: f32,
}

/// The reflection nearest to the robot's footprint in a region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearestReflection {
    /// Sensor that heard it.
    pub sensor_index: usize,
    /// Range from that sensor.
    pub range_m: f64,
    /// Bearing from that sensor.
    pub bearing_rad: f64,
    /// Distance from the robot's footprint.
    pub distance_m: f64,
    /// Place in the robot frame, x and y.
    pub place_m: [f64; 2],
    /// Largest energy E of the cells it was found among; its own is at least half of that.
    pub energy: f32,
    /// +1 left of the robot's x axis, -1 right, 0 when left and right are equally near.
    pub side: i8,
    /// By how much it is nearer to the footprint than the nearest on the other side; infinite without one.
    pub lead_m: f64,
}

/// What one region-based layer sees, fused over the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LayerCue {
    /// Sum over sensors and cells of E|M| (eq. 11 with |M|). Infinite if any value was not finite.
    pub energy: f32,
    /// Sum over sensors and cells of E M / r^2 (the numerator of eq. 12).
    pub turn: f32,
    /// Largest single E|M|.
    pub peak: f32,
    /// The sums of each sensor.
    pub sensors: [SensorSums; SENSORS_MAX],
    /// The reflection nearest to the footprint.
    pub nearest: Option<NearestReflection>,
}

/// A local maximum of the flow-line energy Gamma(d), eq. 14.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallPeak {
    /// Signed lateral distance of the wall from the robot's x axis, left positive, refined between flow lines.
    pub lateral_m: f64,
    /// Gamma at the peak.
    pub strength: f64,
}

/// Walls found along flow lines, strongest first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallPeaks {
    /// Number of valid entries of `peaks`.
    pub count: usize,
    /// The peaks, strongest first.
    pub peaks: [WallPeak; WALL_PEAKS_MAX],
}

impl WallPeaks {
    /// The valid peaks.
    #[must_use]
    pub fn as_slice(&self) -> &[WallPeak] {
        &self.peaks[..self.count.min(WALL_PEAKS_MAX)]
    }
}

/// How far the healthy sensors see along the way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CoverageCue {
    /// Length of way ahead of the footprint, over its whole width, that healthy sensors see without a gap.
    pub ahead_m: f64,
    /// The same behind the footprint; zero while something is heard in the strip that a reverse would move into.
    pub behind_m: f64,
}

/// All that the controller reads of a ping set.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cues {
    /// Oldest emission time of the pings that went in.
    pub emitted_at: Stamp,
    /// Sequence of the ping set.
    pub sequence: u64,
    /// Which sensors went in.
    pub sensors_used: [bool; SENSORS_MAX],
    /// CA region.
    pub collision: LayerCue,
    /// OA region.
    pub obstacle: LayerCue,
    /// RCF regions.
    pub corridor: LayerCue,
    /// AFF walls.
    pub walls: WallPeaks,
    /// What is seen of the way.
    pub coverage: CoverageCue,
}
