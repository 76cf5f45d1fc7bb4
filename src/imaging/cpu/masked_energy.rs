//! Energyscapes to the sums of the mask table's rows (specification, section 5; semantics at [`RowSums`]).
//!
//! In: `[direction][range]` and the table. Out: one [`RowSums`] a row. First the range gain and the noise floor are put on
//! the whole image, then every row is walked twice: for the sums and the peak, then for the nearest cell of at least half the
//! peak. Twin of `shaders/masked_energy.wgsl`. A value that is not finite is infinite energy, never silence.

use super::simd::Vector;
use crate::signal::{MaskRow, MaskTable, NO_CELL, PolarGrid, RowSums};

/// The image with gain and floor on it.
pub(super) struct GainTask<'a> {
    /// `[direction][range]`.
    pub image: &'a [f32],
    /// `[range]`.
    pub gains: &'a [f32],
    /// `[range]`.
    pub floors: &'a [f32],
    /// `[direction][range]`: E, infinite where it is not finite.
    pub energies: &'a mut [f32],
}

/// Puts gain and floor on an image.
#[inline(always)]
pub(super) fn gained<V: Vector>(task: GainTask<'_>) {
    let ranges = task.gains.len();
    for (image, energies) in task.image.chunks_exact(ranges).zip(task.energies.chunks_exact_mut(ranges)) {
        for (((energy, value), gain), floor) in energies.iter_mut().zip(image).zip(task.gains).zip(task.floors) {
            let product = value * gain;
            // By bits, since a comparison may be compiled as if there were no NaN.
            let finite = product.to_bits() & 0x7f80_0000 != 0x7f80_0000;
            let heard = if product < *floor { 0.0 } else { product };
            *energy = if finite { heard } else { f32::INFINITY };
        }
    }
}

/// Weights of the table's entries, computed once.
#[derive(Debug)]
pub(super) struct RowWeights {
    /// side / r^2 per entry.
    pub turn: Vec<f32>,
    /// sqrt(r) per entry.
    pub flow: Vec<f32>,
}

impl RowWeights {
    /// Computes the weights of every entry of `masks` on `grid`.
    pub(super) fn new(masks: &MaskTable, grid: &PolarGrid) -> Self {
        let range_m = |cell: &u32| grid.range_m(grid.direction_and_range(*cell as usize).1);
        Self {
            turn: masks
                .cells
                .iter()
                .zip(&masks.sides)
                .map(|(cell, side)| (f64::from(*side) / range_m(cell).powi(2)) as f32)
                .collect(),
            flow: masks.cells.iter().map(|cell| range_m(cell).sqrt() as f32).collect(),
        }
    }
}

/// Independent partial sums, so that neither latency nor rounding piles up.
const PARTS: usize = 8;

/// Sums over one row.
pub(super) fn masked_energy(masks: &MaskTable, weights: &RowWeights, row: &MaskRow, energies: &[f32]) -> RowSums {
    let range = row.first..row.first + row.count;
    let cells = &masks.cells[range.clone()];
    let turn = &weights.turn[range.clone()];
    let flow = &weights.flow[range.clone()];
    let mut parts = [[0.0_f32; PARTS]; 3];
    let (mut peak, mut active_count) = (0.0_f32, 0_u32);
    for start in (0..cells.len()).step_by(PARTS) {
        for (part, entry) in (start..cells.len().min(start + PARTS)).enumerate() {
            let energy = energies[cells[entry] as usize];
            peak = peak.max(energy);
            active_count += u32::from(energy > 0.0);
            parts[0][part] += energy;
            // Infinite energy has no side: only its sum and peak say so.
            let finite = if energy == f32::INFINITY { 0.0 } else { energy };
            parts[1][part] += finite * turn[entry];
            parts[2][part] += finite * flow[entry];
        }
    }
    if peak == 0.0 {
        return RowSums::SILENT;
    }
    let [energy, turn, flow] = parts.map(|part| part.iter().sum());
    let half = 0.5 * peak;
    let (mut peak_entry, mut nearest_entry, mut nearest_distance_m) = (NO_CELL, NO_CELL, f32::INFINITY);
    for (entry, (cell, distance_m)) in cells.iter().zip(&masks.distances_m[range]).enumerate() {
        let energy = energies[*cell as usize];
        if energy >= half {
            if peak_entry == NO_CELL && energy == peak {
                peak_entry = entry as u32;
            }
            if nearest_entry == NO_CELL || *distance_m < nearest_distance_m {
                nearest_entry = entry as u32;
                nearest_distance_m = *distance_m;
            }
        }
    }
    RowSums { energy, turn, flow, peak, nearest_distance_m, peak_entry, nearest_entry, active_count }
}
