//! `[detect.projection]` and `[detect.ring]` of the configuration (specification, sections 9 and 10).
//!
//! Only numbers and their limits; the detectors themselves stand beside this file.

use crate::parameter::{ParameterError, check_positive, check_range};
use serde::{Deserialize, Serialize};

/// Least cone of the ring in which two neighbours can hear the same thing somewhere.
const RING_CONE_MIN_DEG: f64 = 31.0;

/// `[detect]`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectParams {
    /// Vector projection.
    pub projection: ProjectionParams,
    /// Virtual sonar ring.
    pub ring: RingParams,
}

/// `[detect.projection]`: sonar vectors projected on the planned edge (paper 001).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
}

impl Default for ProjectionParams {
    fn default() -> Self {
        Self { range_max_m: 0.6, edge_distance_max_m: 0.3, threshold: 3.0, cone_deg: 30.0 }
    }
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
}

impl Default for RingParams {
    fn default() -> Self {
        Self { ring_radius_m: 0.15, cone_deg: 45.0, cell_m: 0.2, range_noise_m: 0.01 }
    }
}

impl DetectParams {
    /// Judges the numbers.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[detect]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let ProjectionParams { range_max_m, edge_distance_max_m, threshold, cone_deg } = self.projection;
        check_positive("projection.range_max_m", range_max_m, 20.0)?;
        check_positive("projection.edge_distance_max_m", edge_distance_max_m, 20.0)?;
        // The magnitude N1 N2 ends at 10: a threshold there would never be exceeded.
        check_range("projection.threshold", threshold, 0.0, 9.99)?;
        check_range("projection.cone_deg", cone_deg, 1.0, 180.0)?;
        check_positive("ring.ring_radius_m", self.ring.ring_radius_m, 5.0)?;
        check_range("ring.cone_deg", self.ring.cone_deg, RING_CONE_MIN_DEG, 180.0)?;
        check_range("ring.cell_m", self.ring.cell_m, 0.01, 2.0)?;
        check_positive("ring.range_noise_m", self.ring.range_noise_m, 1.0)
    }
}
