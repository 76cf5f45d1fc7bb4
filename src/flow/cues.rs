//! Masked sums to cues: fusion over sensors, nearest reflections, walls (paper 000, eq. 11 to 14, with |M| where the
//! specification says so).
//!
//! Goes in: one [`RowSums`] a row of the table, and which sensors were imaged. Comes out: [`Cues`].
//!
//! The array's side lobes are some 10 dB down, so a pillar beside the way paints the way itself at its own range, and a wall
//! behind the robot would hold CA for ever. What is much weaker than the loudest echo at its range is therefore no
//! echo. But something weak may hide there: where that happens in the CA region's part of the way, for every sensor that looks there,
//! the way counts as seen up to there only (and [`MASKED_AHEAD_M`] at least, so that the robot creeps on until the ranges part). A sum that is not finite makes every region's energy
//! infinite and the way unseen: a broken image is an obstacle, never free space. Allocates nothing, decides nothing.

use super::mask::{self, FLOW_LINES_MAX, MaskSet, RINGS_MAX, WayPoint};
use super::peaks;
use super::region;
use crate::signal::{
    CoverageCue, Cues, LayerCue, LayerName, MaskPurpose, MaskRow, NO_CELL, NearestReflection, RowSums, SENSORS_MAX,
    WallPeaks,
};
use crate::time::Stamp;

/// `[sensor][ring]`: the largest E.
type Loudest = [[f32; RINGS_MAX]; SENSORS_MAX];

/// Way ahead that is trusted where all of it lies under side lobes: within it a robot stops that creeps at 0.15 m/s. What hides
/// under the lobes of a wall comes out from under them a ring before it is too near to be heard, and that is more.
const MASKED_AHEAD_M: f64 = 0.06;

/// Distances to the footprint that differ by less than this count as equal: what rounding leaves of a mirrored scene.
const EQUAL_DISTANCE_M: f64 = 1e-6;

impl MaskSet {
    /// Fuses the sums of one ping set. `sums` has one entry a row of [`MaskSet::table`]; sensors that were not imaged are
    /// left out.
    ///
    /// Sums of another length than the table's rows count as broken: every region's energy is then infinite.
    #[must_use]
    pub fn fuse(&self, sums: &[RowSums], imaged: [bool; SENSORS_MAX], emitted_at: Stamp, sequence: u64) -> Cues {
        let used = std::array::from_fn(|index| imaged[index] && index < self.sensor_count());
        let mut cues = Cues { emitted_at, sequence, sensors_used: used, ..Cues::default() };
        let mut flows = [0.0f64; FLOW_LINES_MAX];
        let mut behind = 0.0f64;
        let mut masked = [[0.0f32; RINGS_MAX]; SENSORS_MAX];
        let loudest = self.loudest_of_rings(sums, used);
        let mut broken = sums.len() != self.table.rows.len();
        for (index, ((row, ring), sums)) in self.table.rows.iter().zip(&self.rings).zip(sums).enumerate() {
            if !used[row.sensor_index] {
                continue;
            }
            broken |= !is_sound(sums);
            match row.purpose {
                MaskPurpose::Region(layer) => {
                    if !self.is_echo(&loudest, row, *ring, sums) {
                        let energy = self.cell_weight * sums.energy;
                        masked[row.sensor_index][*ring] += if self.in_way[index] { energy } else { 0.0 };
                    } else if let Some(cue) = region_cue(&mut cues, layer) {
                        add(cue, row.sensor_index, sums, self.cell_weight);
                    }
                }
                MaskPurpose::Ring { .. } => {}
                MaskPurpose::Behind => behind += f64::from(self.cell_weight * sums.energy),
                MaskPurpose::FlowLine { index, .. } => {
                    if self.is_echo(&loudest, row, self.ring_of_peak(row, sums), sums) {
                        flows[index] += f64::from(sums.flow);
                    }
                }
            }
        }
        for layer in LayerName::LAYERS {
            let region = |row: &MaskRow| row.purpose == MaskPurpose::Region(layer);
            let echo =
                |row: &MaskRow, ring: usize, sums: &RowSums| region(row) && self.is_echo(&loudest, row, ring, sums);
            let nearest = self.nearest(sums, used, echo).or_else(|| {
                // Nothing but side lobes is heard in the region; what they belong to stands beside it.
                let lit = self.lit_rings(layer, sums, used);
                let beside = |row: &MaskRow, ring: usize, _: &RowSums| is_ring(row) && lit[row.sensor_index][ring];
                self.nearest(sums, used, beside)
            });
            if let Some(cue) = region_cue(&mut cues, layer) {
                cue.nearest = nearest;
                if broken || !cue.energy.is_finite() {
                    (cue.energy, cue.peak, cue.turn) = (f32::INFINITY, f32::INFINITY, 0.0);
                }
            }
        }
        (cues.walls, cues.coverage) = if broken {
            (WallPeaks::default(), CoverageCue::default())
        } else {
            (self.walls(&mut flows, used), self.coverage(used))
        };
        cues.coverage.ahead_m = cues.coverage.ahead_m.min(self.unmasked_ahead_m(&masked, used));
        if !(behind <= self.collision_threshold) {
            cues.coverage.behind_m = 0.0;
        }
        cues
    }

    /// Which sensors have a sum that is no energy: their image is broken. All, for sums of another length than the table's rows.
    #[must_use]
    pub fn broken_sensors(&self, sums: &[RowSums]) -> [bool; SENSORS_MAX] {
        let mut broken = [sums.len() != self.table.rows.len(); SENSORS_MAX];
        for (row, sums) in self.table.rows.iter().zip(sums) {
            broken[row.sensor_index] |= !is_sound(sums);
        }
        broken
    }

    /// Way from the footprint to the first place of the CA region where every sensor that looks there hears side lobes only,
    /// loud enough to hide something; infinite where there is none. `masked` is `[sensor][ring]`, sums of E|M| over the way.
    fn unmasked_ahead_m(&self, masked: &Loudest, used: [bool; SENSORS_MAX]) -> f64 {
        let hides = |sensor: usize, ring: usize| {
            let around = ring.saturating_sub(1)..(ring + 2).min(RINGS_MAX);
            let energy: f32 = masked[sensor][around].iter().sum();
            !(f64::from(energy) <= self.collision_threshold)
        };
        let masked_at = |point: &&WayPoint| {
            let seen =
                || (0..SENSORS_MAX).filter(|index| used[*index]).filter_map(|index| Some((index, point.rings[index]?)));
            seen().next().is_some() && seen().all(|(sensor, ring)| hides(sensor, ring))
        };
        let nearest_m = self.way.iter().filter(masked_at).map(|point| point.distance_m).fold(f64::INFINITY, f64::min);
        nearest_m.max(MASKED_AHEAD_M)
    }

    /// Loudest cell of every ring of every sensor.
    fn loudest_of_rings(&self, sums: &[RowSums], used: [bool; SENSORS_MAX]) -> Loudest {
        let mut loudest = [[0.0f32; RINGS_MAX]; SENSORS_MAX];
        for (row, sums) in self.table.rows.iter().zip(sums).filter(|(row, _)| used[row.sensor_index]) {
            if let MaskPurpose::Ring { index } = row.purpose {
                let loudest = &mut loudest[row.sensor_index][index];
                *loudest = loudest.max(sums.peak);
            }
        }
        loudest
    }

    /// `[sensor][ring]`: the rings in which a layer's region hears anything, and their neighbours.
    fn lit_rings(
        &self,
        layer: LayerName,
        sums: &[RowSums],
        used: [bool; SENSORS_MAX],
    ) -> [[bool; RINGS_MAX]; SENSORS_MAX] {
        let mut lit = [[false; RINGS_MAX]; SENSORS_MAX];
        for ((row, ring), sums) in self.table.rows.iter().zip(&self.rings).zip(sums) {
            if used[row.sensor_index] && row.purpose == MaskPurpose::Region(layer) && sums.active_count > 0 {
                lit[row.sensor_index][ring.saturating_sub(1)..(ring + 2).min(RINGS_MAX)].fill(true);
            }
        }
        lit
    }

    /// Whether a row's loudest cell is an echo, not the side lobe of a louder one at about its range.
    fn is_echo(&self, loudest: &Loudest, row: &MaskRow, ring: usize, sums: &RowSums) -> bool {
        let around = ring.saturating_sub(1)..(ring + 2).min(RINGS_MAX);
        let loudest = loudest[row.sensor_index][around].iter().fold(0.0f32, |loudest, peak| loudest.max(*peak));
        !(f64::from(sums.peak) < self.side_lobe_share * f64::from(loudest))
    }

    /// Ring of the loudest cell of a row that is not cut into rings.
    fn ring_of_peak(&self, row: &MaskRow, sums: &RowSums) -> usize {
        let entry = row.first + (sums.peak_entry as usize).min(row.count.saturating_sub(1));
        let cell = self.table.cells.get(entry).map_or(0, |cell| *cell as usize);
        mask::ring_of(self.grid.range_m(self.grid.direction_and_range(cell).1))
    }

    /// Walls from the sums of E sqrt(r) of all lines, which are turned into Gamma in place.
    fn walls(&self, flows: &mut [f64; FLOW_LINES_MAX], used: [bool; SENSORS_MAX]) -> WallPeaks {
        let gammas = &mut flows[..self.lines.len()];
        for (gamma, line) in gammas.iter_mut().zip(&self.lines) {
            let seen = line.cell_counts.iter().zip(used).filter_map(|(count, used)| used.then_some(f64::from(*count)));
            let seen_count: f64 = seen.sum();
            *gamma = if seen_count > 0.0 { *gamma / seen_count } else { 0.0 };
        }
        peaks::find(|index| self.lines[index].lateral_m, gammas, &self.peaks)
    }

    /// The reflection nearest to the footprint over the rows that `counts` accepts. Rows whose loudest cell is less than half as
    /// loud as the loudest of all do not take part.
    fn nearest(
        &self,
        sums: &[RowSums],
        used: [bool; SENSORS_MAX],
        counts: impl Fn(&MaskRow, usize, &RowSums) -> bool,
    ) -> Option<NearestReflection> {
        let rows = || {
            let all = self.table.rows.iter().zip(&self.rings).zip(sums);
            all.filter(|((row, ring), sums)| used[row.sensor_index] && counts(row, **ring, sums))
                .map(|((row, _), sums)| (row, sums))
        };
        let loudest = rows().fold(0.0f32, |loudest, (_, sums)| loudest.max(sums.peak));
        let mut nearest: [Option<NearestReflection>; 2] = [None; 2];
        for (row, sums) in rows().filter(|(_, sums)| sums.nearest_entry != NO_CELL && sums.peak >= 0.5 * loudest) {
            let Some(found) = self.reflection(row, sums) else { continue };
            let best = &mut nearest[usize::from(found.side < 0)];
            if best.is_none_or(|best| found.distance_m < best.distance_m) {
                *best = Some(found);
            }
        }
        match nearest {
            [Some(left), Some(right)] => {
                let lead_m = (left.distance_m - right.distance_m).abs();
                let nearer = if left.distance_m <= right.distance_m { left } else { right };
                let side = if lead_m <= EQUAL_DISTANCE_M { 0 } else { nearer.side };
                Some(NearestReflection { side, lead_m, ..nearer })
            }
            [one, other] => one.or(other),
        }
    }

    fn reflection(&self, row: &MaskRow, sums: &RowSums) -> Option<NearestReflection> {
        let entry = (sums.nearest_entry as usize) < row.count;
        let entry = entry.then(|| row.first + sums.nearest_entry as usize)?;
        let (direction_index, range_index) = self.grid.direction_and_range(self.table.cells[entry] as usize);
        Some(NearestReflection {
            sensor_index: row.sensor_index,
            range_m: self.grid.range_m(range_index),
            bearing_rad: self.grid.directions()[direction_index].azimuth_rad,
            distance_m: f64::from(self.table.distances_m[entry]),
            place_m: region::cell_point_m(&self.grid, &self.mounts[row.sensor_index], direction_index, range_index)
                .into(),
            energy: sums.peak,
            side: if self.table.sides[entry] >= 0.0 { 1 } else { -1 },
            lead_m: f64::INFINITY,
        })
    }
}

fn is_ring(row: &MaskRow) -> bool {
    matches!(row.purpose, MaskPurpose::Ring { .. })
}

/// Energies are finite and not negative, whatever was heard.
fn is_sound(sums: &RowSums) -> bool {
    let positive = [sums.energy, sums.flow, sums.peak].iter().all(|value| *value >= 0.0 && *value < f32::INFINITY);
    positive && sums.turn.is_finite()
}

fn region_cue(cues: &mut Cues, layer: LayerName) -> Option<&mut LayerCue> {
    match layer {
        LayerName::CollisionAvoidance => Some(&mut cues.collision),
        LayerName::ObstacleAvoidance => Some(&mut cues.obstacle),
        LayerName::CorridorFollowing => Some(&mut cues.corridor),
        LayerName::FlowFollowing | LayerName::PassThrough | LayerName::Stopped => None,
    }
}

fn add(cue: &mut LayerCue, sensor_index: usize, sums: &RowSums, cell_weight: f32) {
    let (energy, turn) = (cell_weight * sums.energy, cell_weight * sums.turn);
    let sensor = &mut cue.sensors[sensor_index];
    sensor.energy += energy;
    sensor.turn += turn;
    sensor.peak = sensor.peak.max(sums.peak);
    cue.energy += energy;
    cue.turn += turn;
    cue.peak = cue.peak.max(sums.peak);
}
