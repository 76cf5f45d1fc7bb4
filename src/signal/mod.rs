//! The nouns: what travels from the microphones to the motors. Constructors hold the invariants; nothing here
//! processes anything.
//!
//! | noun | made by | read by | topic |
//! |---|---|---|---|
//! | [`PingSet`] of [`RawPing`]s | a source | `imaging` | `noctule/sonar/<name>/pdm`, `/pcm`, `/pcm_f32` |
//! | [`Energyscape`] on a [`PolarGrid`] | `imaging` | `flow`, `detect`, anybody | `noctule/sonar/<name>/energyscape` |
//! | [`RangeScan`] | `detect` | anybody | none (recordings carry it) |
//! | [`RobotScan`] | `detect` | anybody | `noctule/scan` |
//! | [`PointCloud`] | `detect` | anybody | `noctule/points` |
//! | [`EgoMotionReport`] with [`Movers`] | `detect` | `control` (the movers), anybody | `noctule/ego_motion` |
//! | [`Mask`], [`MaskTable`] | `flow`, once | `imaging` | none (`noctule masks` writes them) |
//! | [`RowSums`] | `imaging` | `flow` | none |
//! | [`Cues`] | `flow` | `control`, anybody | `noctule/cues` |
//! | [`Decision`] | `control` | `safety`, the controller process | `noctule/command` |
//! | [`DaemonState`], [`GateState`], [`Reason`] | `safety` | anybody | `noctule/command`, `/platform`, `/health` |

mod cues;
mod ego_motion;
mod energyscape;
mod mask;
mod ping;
mod point_cloud;
mod range_scan;
mod robot_scan;
mod status;
mod velocity;

pub use cues::{CoverageCue, Cues, LayerCue, NearestReflection, SensorSums, WALL_PEAKS_MAX, WallPeak, WallPeaks};
pub use ego_motion::{EgoMotionReport, MOVERS_MAX, Mover, Movers};
pub use energyscape::{Direction, Energyscape, PolarGrid};
pub use mask::{Mask, MaskPurpose, MaskRow, MaskTable, NO_CELL, RowSums};
pub use ping::{PingSet, RawPing, SENSORS_MAX, SampleFormat, Samples};
pub use point_cloud::{POINTS_MAX, PointCloud, SLICE_BEARINGS, SpaceClass, SpacePoint};
pub use range_scan::{RangeScan, Reading};
pub use robot_scan::{PEAKS_MAX, Peak, RAYS, Ray, RobotScan};
pub use status::{DaemonState, GateState, Reason};
pub use velocity::{Cause, Decision, LayerName, Velocity};
