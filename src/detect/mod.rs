//! The two range-based detectors: vector projection (paper 001) and the virtual sonar ring (paper 003).
//!
//! Range readings and a pose in; what is in the way, or where objects are, out. Both are pure geometry: where the readings
//! come from, energyscapes or a file, is the caller's business. [`range_scan`] takes them from an energyscape, [`scan_fuser`] from those
//! of all sensors, [`virtual_sonar`] reads that as a sonar would.
//!
//! The way of vector projection: [`projection`] detects on an edge, [`local_map`] remembers reflectors, [`obstacle`] measures and plans
//! a way round, [`path_follower`] drives. [`voronoi`] makes edges from walls.
//!
//! In three dimensions: [`space_peaks`] finds every reflector of an image with elevations, [`space`] makes a cloud of them.
//!
//! Beside them, [`ego_motion`]: how the robot itself moves and what moves beside it, from how echoes move between ping sets.

pub mod ego_fit;
pub mod ego_motion;
pub mod ego_tracks;
pub mod heading;
pub mod local_map;
pub mod obstacle;
pub mod occupancy;
pub mod params;
pub mod path_follower;
pub mod projection;
pub mod range_scan;
pub mod reflectors;
pub mod ring;
pub mod ring_detector;
pub mod route;
pub mod scan_fuser;
mod side_lobes;
pub mod slip;
pub mod space;
pub mod space_peaks;
pub mod tracks;
pub mod triangulation;
pub mod virtual_ring;
pub mod virtual_sonar;
pub mod voronoi;

pub use ego_motion::{EgoMotion, EgoPlatform};
pub use params::{DetectParams, ProjectionParams, RingParams};
pub use path_follower::{Detector, FollowerState, ObstacleReport, PathFollower, ProjectionDetector};
pub use range_scan::RangeScanner;
pub use ring_detector::{RingDetector, RingReport};
pub use scan_fuser::ScanFuser;
pub(crate) use side_lobes::vertex;
pub use space::SpaceDetector;
