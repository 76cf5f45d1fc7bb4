//! `[detect.projection]` and `[detect.ring]` of the configuration (specification, sections 9 and 10).
//!
//! Only numbers and their limits; the detectors themselves stand beside this file.

use crate::parameter::{ParameterError, check_positive, check_range};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// Least cone of the ring in which two neighbours can hear the same thing somewhere.
const RING_CONE_MIN_DEG: f64 = 31.0;
/// Most corners of a planned path.
pub const PATH_POINTS_MAX: usize = 64;
/// Farthest coordinate of a planned path.
const COORDINATE_MAX_M: f64 = 1e4;
/// Shortest edge.
const EDGE_MIN_M: f64 = 0.01;

/// `[detect]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectParams {
    /// Whether the daemon runs the detectors and publishes `noctule/scan`, `noctule/obstacle`, `noctule/objects`,
    /// `noctule/ego_motion` and, on a grid with elevations, `noctule/points`.
    pub enabled: bool,
    /// Whether the follower of `projection.path_m` drives: it then publishes what it wishes on `noctule/input`, as any planner.
    pub drive_path: bool,
    /// Vector projection.
    pub projection: ProjectionParams,
    /// Virtual sonar ring.
    pub ring: RingParams,
}

impl Default for DetectParams {
    fn default() -> Self {
        Self { enabled: true, drive_path: false, projection: ProjectionParams::default(), ring: RingParams::default() }
    }
}

/// `[detect.projection]`: sonar vectors projected on the planned edge (paper 001), and the drive along a planned path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProjectionParams {
    /// Range beyond which a reading has no length: N1 = 10 (1 - r / range_max_m).
    pub range_max_m: f64,
    /// Distance from the edge beyond which the detector is blind: N2 = 1 - 0.6 d / edge_distance_max_m (the paper's d_max).
    #[serde(alias = "d_max_m")]
    pub edge_distance_max_m: f64,
    /// A projection above this is an obstacle.
    pub threshold: f64,
    /// Full apex angle of a virtual sonar's cone.
    pub cone_deg: f64,
    /// Corners of the planned path in the frame of odometry; the pieces between them are the desired edges. Empty: no path, the
    /// detector idles.
    #[serde(deserialize_with = "points")]
    pub path_m: Vec<[f64; 2]>,
    /// Width that the robot needs; a passage that is narrower is none.
    pub safe_width_m: f64,
    /// Whether only reflectors on the safe path count, within half of `safe_width_m` of the edge. The paper's sonars do not say
    /// where in its cone a reflector stands, so there all count.
    pub safe_path_only: bool,
    /// Speed that the follower of the path wishes.
    pub speed_m_s: f64,
}

impl Default for ProjectionParams {
    fn default() -> Self {
        Self {
            range_max_m: 0.6,
            edge_distance_max_m: 0.3,
            threshold: 3.0,
            cone_deg: 30.0,
            path_m: Vec::new(),
            safe_width_m: 0.6,
            safe_path_only: true,
            speed_m_s: 0.2,
        }
    }
}

impl ProjectionParams {
    /// Judges the numbers.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[detect.projection]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_positive("range_max_m", self.range_max_m, 20.0)?;
        check_positive("edge_distance_max_m", self.edge_distance_max_m, 20.0)?;
        // The magnitude N1 N2 ends at 10: a threshold there would never be exceeded.
        check_range("threshold", self.threshold, 0.0, 9.99)?;
        check_range("cone_deg", self.cone_deg, 1.0, 180.0)?;
        let count = self.path_m.len();
        if count == 1 || count > PATH_POINTS_MAX {
            let allowed = format!("no point, or 2 to {PATH_POINTS_MAX}");
            return Err(ParameterError::new("path_m", format!("{count} points"), allowed));
        }
        for (index, point) in self.path_m.iter().enumerate() {
            for (axis, coordinate_m) in point.iter().enumerate() {
                check_range(&format!("path_m[{index}][{axis}]"), *coordinate_m, -COORDINATE_MAX_M, COORDINATE_MAX_M)?;
            }
            let before = index.checked_sub(1).map(|before| self.path_m[before]);
            if before.is_some_and(|before| (before[0] - point[0]).hypot(before[1] - point[1]) < EDGE_MIN_M) {
                let found = format!("[{}, {}] beside the point before", point[0], point[1]);
                let allowed = format!("a point at least {EDGE_MIN_M} m from the one before");
                return Err(ParameterError::new(format!("path_m[{index}]"), found, allowed));
            }
        }
        check_range("safe_width_m", self.safe_width_m, 0.05, 10.0)?;
        check_positive("speed_m_s", self.speed_m_s, 5.0)
    }
}

/// Points of two coordinates, no more: a plain array would quietly drop a third.
fn points<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let pair = |point: Vec<f64>| {
        let count = point.len();
        let refuse = |_| D::Error::custom(format!("found {count} coordinates, allowed: 2, as in [1.0, 2.0]"));
        <[f64; 2]>::try_from(point).map_err(refuse)
    };
    Vec::<Vec<f64>>::deserialize(deserializer)?.into_iter().map(pair).collect()
}

/// `[detect.ring]`: twelve virtual sonars, 30 degrees apart (paper 003).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RingParams {
    /// Radius R of the ring on which the virtual sonars stand.
    pub ring_radius_m: f64,
    /// Full apex angle of a virtual sonar's cone. Neighbours look 30 degrees apart and stand apart, too: cones of 30 degrees
    /// never meet, those of 45 do from 0.3 m on.
    pub cone_deg: f64,
    /// Edge of a cell of the occupancy grid.
    pub cell_m: f64,
    /// Standard deviation of a reading.
    pub range_noise_m: f64,
    /// Farthest that a virtual sonar reads, from its place on the ring.
    pub range_max_m: f64,
}

impl Default for RingParams {
    fn default() -> Self {
        Self { ring_radius_m: 0.15, cone_deg: 45.0, cell_m: 0.2, range_noise_m: 0.01, range_max_m: 2.0 }
    }
}

impl DetectParams {
    /// Judges the numbers.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[detect]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        self.projection.validate().map_err(|error| error.within("projection"))?;
        if self.drive_path && !(self.enabled && self.projection.path_m.len() > 1) {
            return Err(ParameterError::new("drive_path", true, "false, or enabled = true and a projection.path_m"));
        }
        check_positive("ring.ring_radius_m", self.ring.ring_radius_m, 5.0)?;
        check_range("ring.cone_deg", self.ring.cone_deg, RING_CONE_MIN_DEG, 180.0)?;
        check_range("ring.cell_m", self.ring.cell_m, 0.01, 2.0)?;
        check_positive("ring.range_noise_m", self.ring.range_noise_m, 1.0)?;
        check_positive("ring.range_max_m", self.ring.range_max_m, 20.0)
    }
}
