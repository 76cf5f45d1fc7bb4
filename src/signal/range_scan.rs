//! Range scan: the nearest echo of every direction of one energyscape, for readers that think in ranges.

use super::PolarGrid;
use crate::time::Stamp;
use std::sync::Arc;

/// What one direction has to say. The three answers must not be mixed up: unseen is not free.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Reading {
    /// Nobody can know: hidden, or the image is spoilt there.
    #[default]
    Unseen,
    /// No echo between the first and the last range bin.
    Clear,
    /// The nearest echo.
    Echo {
        /// Its range.
        range_m: f64,
        /// Its envelope, linear amplitude in units of full scale.
        energy: f32,
    },
}

/// One reading a direction of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeScan {
    /// The grid of the energyscape; the readings are in the order of its directions.
    pub grid: Arc<PolarGrid>,
    /// Index of the sensor in the configuration.
    pub sensor_index: usize,
    /// Sequence of the raw ping.
    pub sequence: u64,
    /// Emission time of the raw ping, unchanged.
    pub emitted_at: Stamp,
    /// One a direction.
    pub readings: Vec<Reading>,
}

impl RangeScan {
    /// A scan on `grid` that knows nothing.
    #[must_use]
    pub fn unseen(grid: Arc<PolarGrid>, sensor_index: usize) -> Self {
        let readings = vec![Reading::Unseen; grid.direction_count()];
        Self { grid, sensor_index, sequence: 0, emitted_at: Stamp::default(), readings }
    }
}
