//! `[control]` and `[platform]` to what a mask set is built from. `flow` and `control` do not know each other; whoever wires
//! them asks here, so that masks, tools and daemon mean the same regions.

use crate::control::{ControlParams, PlatformLimits};
use crate::flow::{MaskParams, NoiseFloor, PeakParams, RangeGain};
use crate::imaging::params::DirectionsParams;

/// The regions of the layers that are on, and the rules that go with them.
///
/// Walls are looked for from the lower of flow following's release thresholds, so that its hysteresis sees them fade.
#[must_use]
pub fn mask_params(control: &ControlParams, platform: &PlatformLimits, directions: &DirectionsParams) -> MaskParams {
    let on = |enabled: bool, regions: &[crate::geometry::shape::Shape]| {
        if enabled { regions.to_vec() } else { Vec::new() }
    };
    let flow = &control.flow_following;
    MaskParams {
        collision_avoidance: on(control.collision_avoidance.enabled, &control.collision_avoidance.regions),
        obstacle_avoidance: on(control.obstacle_avoidance.enabled, &control.obstacle_avoidance.regions),
        corridor_following: on(control.corridor_following.enabled, &control.corridor_following.regions),
        flow_lines: if flow.enabled { flow.regions.clone() } else { Vec::new() },
        peaks: PeakParams {
            threshold: flow.threshold_single.min(flow.threshold_corridor) * flow.release_ratio,
            prominence: flow.prominence,
            separation_m: flow.separation_m,
        },
        range_gain: RangeGain {
            spreading_exponent: control.energy.spreading_exponent,
            absorption_db_m: control.energy.absorption_db_m,
        },
        noise_floor: NoiseFloor::configured(control.energy.noise_floor_dbfs.clone()),
        side_lobe_share: control.energy.side_lobe_share(),
        z_m: platform.z_m,
        cell_weight: directions.cell_weight(),
        footprint_radius_m: platform.radius_m,
        collision_threshold: control.collision_avoidance.threshold,
        blind_gap_m: control.coverage.blind_gap_m,
    }
}
