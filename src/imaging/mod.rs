//! Raw pings to energyscapes.

pub mod backend;
pub mod channels;
pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod params;
pub mod plan;
pub mod steering;
