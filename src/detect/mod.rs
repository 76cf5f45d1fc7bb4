//! The two range-based detectors: vector projection (paper 001) and the virtual sonar ring (paper 003).

pub mod params;

pub use params::{DetectParams, ProjectionParams, RingParams};
