//! What a mask set is built from besides sensors and grid. Whoever wires the service fills it from `[control]` and
//! `[platform]`; this module does not know their tables.

use super::energy::{NoiseFloor, RangeGain};
use crate::geometry::flow_lines::FlowLinesRegion;
use crate::geometry::shape::Shape;

/// Regions and rules of a mask set. A layer without regions is off.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskParams {
    /// CA: union of shapes in the robot frame.
    pub collision_avoidance: Vec<Shape>,
    /// OA.
    pub obstacle_avoidance: Vec<Shape>,
    /// RCF.
    pub corridor_following: Vec<Shape>,
    /// AFF.
    pub flow_lines: Vec<FlowLinesRegion>,
    /// What counts as a wall along the flow lines.
    pub peaks: PeakParams,
    /// Gain on the envelope.
    pub range_gain: RangeGain,
    /// Envelope below which a cell counts as silent, before the gain.
    pub noise_floor: NoiseFloor,
    /// Lowest and highest part of the robot above the plane of the sensors' origins; cells that are lower or higher are in no region.
    pub z_m: Option<[f64; 2]>,
    /// What a cell of E adds to a sum: 1 on the fan that thresholds are made for, less on a grid with more cells to a beam.
    pub cell_weight: f32,
    /// Radius of the robot's footprint.
    pub footprint_radius_m: f64,
    /// A cell whose energy is less than this share of the loudest at its range, heard by the same sensor in any direction,
    /// may be that echo's side lobe. 0 trusts every cell.
    pub side_lobe_share: f64,
    /// T_CA: sum of E|M| right behind the footprint above which the way back is not free, and of side lobes in the CA region above
    /// which the way ahead is not seen.
    pub collision_threshold: f64,
    /// Longest unseen stretch right at the footprint that counts as seen before (see `flow::coverage`).
    pub blind_gap_m: f64,
}

/// What makes a local maximum of Gamma(d) a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeakParams {
    /// Least Gamma.
    pub threshold: f64,
    /// By how much it stands out between its neighbours.
    pub prominence: f64,
    /// Least distance from a stronger peak.
    pub separation_m: f64,
}
