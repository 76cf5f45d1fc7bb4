//! The two range-based detectors: vector projection (paper 001) and the virtual sonar ring (paper 003).
//!
//! Range readings and a pose in; what is in the way, or where objects are, out. Both are pure geometry: where the readings
//! come from, energyscapes or a file, is the caller's business. [`range_scan`] takes them from an energyscape.

pub mod params;
pub mod projection;
pub mod range_scan;
pub mod ring;

pub use params::{DetectParams, ProjectionParams, RingParams};
pub use range_scan::RangeScanner;
