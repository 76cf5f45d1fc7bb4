//! Ternary masks of control regions, and the flat table of them that a backend sums over.

use super::LayerName;

/// Marks "no cell" in [`RowSums`].
pub const NO_CELL: u32 = u32::MAX;

/// One region in one sensor's grid: +1 left of the robot's x axis, -1 right of it, 0 outside or unseen.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// The layer whose region this is.
    pub layer: LayerName,
    /// Index of the sensor in the configuration.
    pub sensor_index: usize,
    /// `[direction][range]`, row-major, as the energyscape.
    pub values: Vec<i8>,
}

/// What a row of the table is summed for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MaskPurpose {
    /// The region of a behaviour layer.
    Region(LayerName),
    /// All that a sensor sees between two ranges: what is loud here has side lobes in every other direction.
    Ring {
        /// Index of the ring, counted from range zero.
        index: usize,
    },
    /// The strip behind the footprint that a reversing robot moves into.
    Behind,
    /// The flow line of constant lateral distance `lateral_m` (left positive), paper 000, eq. 9.
    FlowLine {
        /// Index of the flow line, ascending in lateral distance.
        index: usize,
        /// Its distance from the robot's x axis.
        lateral_m: f64,
    },
}

/// One list of cells of one sensor's energyscape.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskRow {
    /// What the sums are for.
    pub purpose: MaskPurpose,
    /// Index of the sensor in the configuration.
    pub sensor_index: usize,
    /// First entry in the table's cell arrays.
    pub first: usize,
    /// Number of entries.
    pub count: usize,
}

/// All rows of all sensors as flat arrays, so that both backends read the same bytes.
///
/// Per cell: its index, its side (+1 or -1) and its distance from the robot's footprint. Per sensor and range bin: the
/// range gain that the envelope is multiplied with, and the noise floor below which the product counts as zero.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MaskTable {
    /// The rows; cells of row i are `first .. first + count`.
    pub rows: Vec<MaskRow>,
    /// Cell index in the sensor's grid.
    pub cells: Vec<u32>,
    /// +1.0 left, -1.0 right.
    pub sides: Vec<f32>,
    /// Distance from the robot's footprint, metres, zero inside it.
    pub distances_m: Vec<f32>,
    /// `[sensor][range]` gain on the envelope.
    pub gains: Vec<Vec<f32>>,
    /// `[sensor][range]` noise floor, compared with the gained envelope.
    pub floors: Vec<Vec<f32>>,
}

/// The sums over one row, with E the gained envelope where it is not below the floor, else zero.
///
/// A cell that is not finite makes `energy` and `peak` infinite, so that every later comparison sees an obstacle. Layout
/// shared with `shaders/masked_energy.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct RowSums {
    /// Sum of E|M|.
    pub energy: f32,
    /// Sum of E M / r^2, with r in metres, the cell's range from the sensor.
    pub turn: f32,
    /// Sum of E sqrt(r): the numerator of eq. 14.
    pub flow: f32,
    /// Largest E.
    pub peak: f32,
    /// Distance from the footprint of the nearest cell with E >= peak / 2; infinite when there is none.
    pub nearest_distance_m: f32,
    /// Entry (index into the table's arrays, relative to the row's `first`) of the largest E, lowest of equals, or [`NO_CELL`].
    pub peak_entry: u32,
    /// Entry of the nearest cell with E >= peak / 2, lowest of equals, or [`NO_CELL`].
    pub nearest_entry: u32,
    /// Number of cells with E above zero.
    pub active_count: u32,
}

impl RowSums {
    /// The sums of a row in which nothing is heard.
    pub const SILENT: RowSums = RowSums {
        energy: 0.0,
        turn: 0.0,
        flow: 0.0,
        peak: 0.0,
        nearest_distance_m: f32::INFINITY,
        peak_entry: NO_CELL,
        nearest_entry: NO_CELL,
        active_count: 0,
    };
}
