//! Where echoes go, and what a region of the robot's surroundings sees of them.
//!
//! Built once per configuration: [`MaskSet`] turns control regions into masks on every sensor's grid and into the flat
//! table that the imaging backends sum over. Per ping set: [`MaskSet::fuse`] turns those sums into [`crate::signal::Cues`].
//! Paper 000, sections 3 and 4, as corrected by the specification. Never images, never decides.

mod coverage;
mod cues;
pub mod energy;
pub mod field;
pub mod flow_line;
mod mask;
mod params;
mod peaks;
pub mod region;

pub use coverage::View;
pub use energy::{CalibrationError, NoiseFloor, RangeGain};
pub use field::{FlowRate, flow_rate};
pub use mask::{FLOW_LINES_MAX, MaskSet};
pub use params::{MaskParams, PeakParams};
