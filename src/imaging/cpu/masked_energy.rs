//! Energyscapes to the sums of the mask table's rows (specification, section 5; semantics at [`RowSums`]).
//!
//! In: the `[direction][range]` image of a sensor and a row's runs of neighbouring cells. Out: [`RowSums`]. Range gain and noise floor are put
//! on the cells of the row alone, a vector at a time; the sums and the peak come first, then the nearest cell of at least half
//! the peak. Twin of `shaders/masked_energy.wgsl`. A value that is not finite is infinite energy, never silence.

use super::aligned::{Aligned, rows, rows_mut};
use super::simd::Vector;
use crate::imaging::plan::ImagingPlan;
use crate::signal::{MaskTable, NO_CELL, RowSums};
use std::ops::Range;

/// Neighbouring cells of one direction on the same side.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// First cell in the image.
    cell: u32,
    /// Range of the first cell.
    range: u32,
    /// Entry of the first cell, counted from the row's first.
    entry: u32,
    /// At most the lanes of a vector.
    len: u32,
    /// +1 or -1.
    side: f32,
}

/// The mask table, laid out for vectors.
#[derive(Debug)]
pub(super) struct RowRuns {
    runs: Vec<Run>,
    /// Runs of each row.
    rows: Vec<Range<usize>>,
    /// `[range]`: 1 / r^2 and sqrt(r), padded by a vector.
    turn: Aligned,
    flow: Aligned,
    /// `[sensor][range]`, padded by a vector.
    gains: Vec<Aligned>,
    floors: Vec<Aligned>,
    lanes: usize,
}

/// Values with a vector's length of zeros behind them.
fn padded(values: impl ExactSizeIterator<Item = f32>, lanes: usize) -> Aligned {
    let mut padded = Aligned::zeros(values.len() + lanes);
    padded.iter_mut().zip(values).for_each(|(padded, value)| *padded = value);
    padded
}

impl RowRuns {
    /// Lays out the rows of `masks` for vectors of `lanes`.
    pub(super) fn new(masks: &MaskTable, plan: &ImagingPlan, lanes: usize) -> Self {
        let ranges = plan.grid.range_count();
        let weight = |of: fn(f64) -> f64| padded((0..ranges).map(|range| of(plan.grid.range_m(range)) as f32), lanes);
        let table = |table: &[Vec<f32>], default: f32| {
            let of = |sensor: usize| match table.get(sensor).filter(|row| row.len() == ranges) {
                Some(row) => padded(row.iter().copied(), lanes),
                None => padded(std::iter::repeat_n(default, ranges), lanes),
            };
            (0..plan.sensors.len()).map(of).collect()
        };
        let (mut runs, mut rows) = (Vec::new(), Vec::new());
        for row in &masks.rows {
            let first = runs.len();
            for entry in row.first..row.first + row.count {
                let (cell, side) = (masks.cells[entry], masks.sides[entry]);
                let range = cell % ranges as u32;
                match runs[first..].last_mut() {
                    Some(Run { cell: start, len, side: same, .. })
                        if *start + *len == cell && range != 0 && *same == side && (*len as usize) < lanes =>
                    {
                        *len += 1;
                    }
                    _ => runs.push(Run { cell, range, entry: (entry - row.first) as u32, len: 1, side }),
                }
            }
            rows.push(first..runs.len());
        }
        Self {
            runs,
            rows,
            // Range zero has no side; the flow layer masks it nowhere.
            turn: weight(|range_m| if range_m > 0.0 { range_m.powi(-2) } else { 0.0 }),
            flow: weight(f64::sqrt),
            gains: table(&masks.gains, 1.0),
            floors: table(&masks.floors, 0.0),
            lanes,
        }
    }

    /// Rows in order, cut where about `runs_per_piece` runs are together.
    pub(super) fn pieces(&self, runs_per_piece: usize) -> Vec<Range<usize>> {
        let mut pieces = Vec::new();
        let mut first = 0;
        for (index, row) in self.rows.iter().enumerate() {
            if row.end - self.rows[first].start >= runs_per_piece || index + 1 == self.rows.len() {
                pieces.push(first..index + 1);
                first = index + 1;
            }
        }
        pieces
    }

    /// Values of scratch that the longest row needs.
    pub(super) fn scratch_len(&self) -> usize {
        self.rows.iter().map(Range::len).max().unwrap_or(0) * self.lanes
    }
}

/// One row.
pub(super) struct RowTask<'a> {
    pub runs: &'a RowRuns,
    pub row: usize,
    pub sensor: usize,
    /// `[direction][range]`.
    pub image: &'a [f32],
    /// Distance of each of the row's entries.
    pub distances_m: &'a [f32],
    /// Of [`RowRuns::scratch_len`].
    pub scratch: &'a mut [f32],
    pub sums: &'a mut RowSums,
}

/// Sums over one row.
#[inline(always)]
pub(super) fn masked_energy<V: Vector>(task: RowTask<'_>) {
    let RowTask { runs: table, row, sensor, image, distances_m, scratch, sums } = task;
    let runs = &table.runs[table.rows[row].clone()];
    let energies = &mut rows_mut::<V>(scratch)[..runs.len()];
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let mut lane_numbers = V::ROW_OF_ZEROS;
    lane_numbers.as_mut().iter_mut().enumerate().for_each(|(lane, number)| *number = lane as f32);
    let lane_numbers = V::load(&lane_numbers);
    let (mut energy_sum, mut turn_sum, mut flow_sum, mut peaks, mut count) = (zero, zero, zero, zero, zero);
    for (run, kept) in runs.iter().zip(energies.iter_mut()) {
        let (energy, heard) = gained::<V>(table, sensor, image, run);
        let inside = V::splat(run.len as f32);
        let energy = lane_numbers.where_less(inside, energy, zero);
        let heard = lane_numbers.where_less(inside, heard, zero);
        let range = run.range as usize;
        let at = |values: &Aligned| V::load(&rows::<V>(&values[range..][..V::LANES])[0]);
        energy_sum = energy_sum.add(energy);
        // Infinite energy has no side: only its sum and peak say so.
        turn_sum = heard.mul_add(at(&table.turn).mul(V::splat(run.side)), turn_sum);
        flow_sum = heard.mul_add(at(&table.flow), flow_sum);
        peaks = peaks.where_less(energy, energy, peaks);
        count = count.add(zero.where_less(energy, one, zero));
        energy.store(kept);
    }
    let mut lanes = V::ROW_OF_ZEROS;
    peaks.store(&mut lanes);
    let peak = lanes.as_ref().iter().fold(0.0_f32, |peak, value| peak.max(*value));
    if peak == 0.0 {
        *sums = RowSums::SILENT;
        return;
    }
    let mut found = RowSums {
        energy: energy_sum.sum(),
        turn: turn_sum.sum(),
        flow: flow_sum.sum(),
        peak,
        active_count: count.sum() as u32,
        ..RowSums::SILENT
    };
    find_nearest::<V>(runs, energies, distances_m, &mut found);
    *sums = found;
}

/// Energy of a run's cells with gain and floor, infinite where the cell is not finite; and the same with zero there.
#[inline(always)]
fn gained<V: Vector>(table: &RowRuns, sensor: usize, image: &[f32], run: &Run) -> (V, V) {
    let (cell, range) = (run.cell as usize, run.range as usize);
    let values = match image.get(cell..cell + V::LANES) {
        Some(values) => V::load(&rows::<V>(values)[0]),
        None => {
            // At the very end of the image.
            let mut row = V::ROW_OF_ZEROS;
            let rest = &image[cell..];
            row.as_mut()[..rest.len()].copy_from_slice(rest);
            V::load(&row)
        }
    };
    let at = |values: &[Aligned]| V::load(&rows::<V>(&values[sensor][range..][..V::LANES])[0]);
    let (zero, infinite) = (V::splat(0.0), V::splat(f32::INFINITY));
    let product = values.mul(at(&table.gains));
    let heard = product.where_less(at(&table.floors), zero, product);
    let finite = product.abs();
    (finite.where_less(infinite, heard, infinite), finite.where_less(infinite, heard, zero))
}

/// The first entry of the peak, and the nearest of at least half the peak, the first of equals.
#[inline(always)]
fn find_nearest<V: Vector>(runs: &[Run], energies: &[V::Row], distances_m: &[f32], found: &mut RowSums) {
    let half = V::splat(0.5 * found.peak);
    let all = u32::MAX >> (32 - V::LANES);
    for (run, row) in runs.iter().zip(energies) {
        let mut loud = !V::load(row).less_bits(half) & all;
        while loud != 0 {
            let lane = loud.trailing_zeros();
            loud &= loud - 1;
            let entry = run.entry + lane;
            let distance_m = distances_m[entry as usize];
            if found.peak_entry == NO_CELL && row.as_ref()[lane as usize] == found.peak {
                found.peak_entry = entry;
            }
            if found.nearest_entry == NO_CELL || distance_m < found.nearest_distance_m {
                found.nearest_entry = entry;
                found.nearest_distance_m = distance_m;
            }
        }
    }
}
