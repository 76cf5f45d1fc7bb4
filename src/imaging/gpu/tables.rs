//! The tables that the shaders read, made in f64 at open: bit sums of the PDM filter, taps by phase, beams of the
//! steering, entries of the masks.
//!
//! In: plan and mask table. Out: flat arrays and the sizes that index them. Never touches a device.

use super::params::channel_stride;
use crate::imaging::plan::clean::CleanPlan;
use crate::imaging::plan::focus::FocusBlock;
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use crate::signal::MaskTable;
use std::collections::HashMap;

/// The PDM filter as sums over bytes of bits, in fixed point: exact on every device, and finer than the f32 taps.
#[derive(Debug, Default)]
pub(super) struct BitWindow {
    /// Blocks of 32 zeros before word 0.
    pub lead_blocks: usize,
    /// First bit that the thread of outputs 0 to 3 reads.
    pub start: usize,
    /// Blocks of 32 bits that a thread reads.
    pub step_count: usize,
    /// Blocks of a channel's stream.
    pub block_count: usize,
    /// Fixed point to full scale.
    pub scale: f32,
    /// `[byte of the window][pattern]`: what the bits add to 4 consecutive outputs, twice the taps.
    pub sums: Vec<[i32; 4]>,
    /// `[output / 4]`: minus the sum of the taps on words of the ping, so that a bit counts +1 or -1 and a word outside 0.
    pub corrections: Vec<[i32; 4]>,
}

impl BitWindow {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let taps = &plan.demodulation_taps;
        if taps.is_empty() {
            return Self { sums: vec![[0; 4]], corrections: vec![[0; 4]], ..Self::default() };
        }
        let (half, decimation) = (taps.len() / 2, plan.decimation);
        let total: f64 = taps.iter().map(|tap| f64::from(tap.abs())).sum();
        // Three times the sum bounds bits and correction together; two bits stay free.
        let one = 2.0_f64.powi((2.0_f64.powi(30) / (3.0 * total)).log2().floor() as i32);
        let fixed: Vec<i32> = taps.iter().map(|tap| (f64::from(*tap) * one).round() as i32).collect();
        let step_count = (taps.len() + 3 * decimation).div_ceil(32);
        let lead_blocks = half.div_ceil(32);
        let start = 32 * lead_blocks - half;
        let quads = plan.sample_count.div_ceil(4);
        Self {
            lead_blocks,
            start,
            step_count,
            block_count: (start + 4 * (quads - 1) * decimation) / 32 + step_count + 1,
            scale: (1.0 / one) as f32,
            sums: byte_sums(&fixed, decimation, 4 * step_count),
            corrections: corrections(&fixed, plan, quads),
        }
    }
}

/// `[sensor][bin]`: what each sensor's spectra are multiplied with.
pub(super) fn references(plan: &ImagingPlan) -> Vec<[f32; 2]> {
    plan.sensors.iter().flat_map(|sensor| sensor.reference.iter().copied()).collect()
}

fn byte_sums(fixed: &[i32], decimation: usize, byte_count: usize) -> Vec<[i32; 4]> {
    let tap = |bit: usize, output: usize| {
        bit.checked_sub(output * decimation).and_then(|index| fixed.get(index)).copied().unwrap_or(0)
    };
    let sum = |byte: usize, pattern: usize, output: usize| {
        (0..8).filter(|bit| pattern >> bit & 1 == 1).map(|bit| 2 * tap(8 * byte + bit, output)).sum()
    };
    (0..byte_count)
        .flat_map(|byte| (0..256).map(move |pattern| std::array::from_fn(|output| sum(byte, pattern, output))))
        .collect()
}

fn corrections(fixed: &[i32], plan: &ImagingPlan, quads: usize) -> Vec<[i32; 4]> {
    let mut before = vec![0];
    for tap in fixed {
        before.push(before[before.len() - 1] + tap);
    }
    let half = fixed.len() / 2;
    let one = |output: usize| {
        let centre = output * plan.decimation;
        let first = half.saturating_sub(centre).min(fixed.len());
        let end = (plan.raw_count + half).saturating_sub(centre).min(fixed.len()).max(first);
        before[first] - before[end]
    };
    (0..quads).map(|quad| std::array::from_fn(|output| one(4 * quad + output))).collect()
}

/// The demodulated signal and the band filter's taps by phase: sample q D + p stands in row p at q, with margins on both sides.
#[derive(Debug)]
pub(super) struct PhaseRows {
    /// Samples of a row, a multiple of 4.
    pub stride: usize,
    /// Samples before sample 0, a multiple of 4.
    pub lead: usize,
    /// Groups of 4 taps in a phase.
    pub tap_step_count: usize,
    /// `[phase][pair]`: two complex taps.
    pub taps: Vec<[f32; 4]>,
}

impl PhaseRows {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let (half, phases) = (plan.band_taps.len() / 2, plan.band_decimation);
        let lead = half.div_ceil(phases).next_multiple_of(4);
        let tap_step_count = (lead + half / phases + 1).div_ceil(4);
        let mut taps = vec![[0.0; 2]; phases * 4 * tap_step_count];
        for (index, tap) in plan.band_taps.iter().enumerate() {
            // index - half = D m + p with p from 0 to D - 1, and m + lead is not negative.
            let shifted = index + phases * lead - half;
            taps[shifted % phases * 4 * tap_step_count + shifted / phases] = *tap;
        }
        Self {
            // A thread of 8 outputs reads two vectors beyond its last group of taps.
            stride: plan.forward_len.next_multiple_of(8) + 4 * tap_step_count + 8,
            lead,
            tap_step_count,
            taps: taps.chunks_exact(2).map(|pair| [pair[0][0], pair[0][1], pair[1][0], pair[1][1]]).collect(),
        }
    }
}

/// A beam without a mirror image, or none at all.
const NO_SLOT: u32 = u32::MAX;

/// Sensors that share their steering.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SteeringGroup {
    /// One to three sensors.
    pub sensors: Vec<usize>,
    /// Their channels.
    pub channel_count: usize,
    /// First quad of beams, and how many.
    pub quad_first: usize,
    pub quad_count: usize,
    /// Direction of every slot: mirror images stand side by side, in the order of the beams.
    pub directions: Vec<u32>,
    /// Slots before each quad, and at the end all of them.
    pub slots_before: Vec<usize>,
}

/// All beams of all groups.
#[derive(Debug, Default)]
pub(super) struct Steering {
    pub groups: Vec<SteeringGroup>,
    /// `[quad][channel]`: turns a bin for four beams.
    pub turns: Vec<[f32; 4]>,
    /// `[beam]`: slots of a direction and of its mirror image, counted from the group's first.
    pub beams: Vec<[u32; 2]>,
}

impl Steering {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let mut steering = Self::default();
        for (index, sensor) in plan.sensors.iter().enumerate().filter(|(index, sensor)| sensor.steering_of == *index) {
            let sensors = (0..plan.sensors.len()).filter(|other| plan.sensors[*other].steering_of == index).collect();
            let quad_first = steering.beams.len() / 4;
            let channels = sensor.channel_count;
            let row = |direction: u32| &sensor.delays_s[direction as usize * channels..][..channels];
            let pairs = mirror_pairs(plan.grid.direction_count(), row);
            let (mut directions, mut slots_before) = (Vec::new(), Vec::new());
            for quad in pairs.chunks(4) {
                slots_before.push(directions.len());
                for beam in 0..4 {
                    let pair = quad.get(beam).copied().unwrap_or([NO_SLOT; 2]);
                    steering.beams.push(pair.map(|direction| match direction {
                        NO_SLOT => NO_SLOT,
                        direction => {
                            directions.push(direction);
                            directions.len() as u32 - 1
                        }
                    }));
                }
                let turn = |beam: usize, channel: usize| {
                    let delay_s = quad.get(beam).and_then(|pair| row(pair[0]).get(channel));
                    delay_s.map_or(0.0, |delay_s| delay_s * plan.bin_step_hz) as f32
                };
                let vector = |channel| std::array::from_fn(|beam| turn(beam, channel));
                steering.turns.extend((0..channel_stride(plan)).map(vector));
            }
            let quad_count = slots_before.len();
            slots_before.push(directions.len());
            let channel_count = channels;
            steering.groups.push(SteeringGroup {
                sensors,
                channel_count,
                quad_first,
                quad_count,
                directions,
                slots_before,
            });
        }
        steering
    }
}

/// Delays closer than this are the same: at 100 kHz a hundred-millionth of a turn.
const SAME_DELAY_S: f64 = 1e-13;

/// Pairs of directions with opposite delays, and the rest alone.
fn mirror_pairs<'a>(direction_count: usize, row: impl Fn(u32) -> &'a [f64]) -> Vec<[u32; 2]> {
    let key = |direction: u32, sign: f64| -> Vec<i64> {
        row(direction).iter().map(|delay_s| (sign * delay_s / SAME_DELAY_S).round() as i64).collect()
    };
    let directions = 0..direction_count as u32;
    let by_delays: HashMap<Vec<i64>, u32> =
        directions.clone().map(|direction| (key(direction, 1.0), direction)).collect();
    let mut taken = vec![false; direction_count];
    let mut pairs = Vec::new();
    for direction in directions {
        if std::mem::replace(&mut taken[direction as usize], true) {
            continue;
        }
        let free = |other: &u32| !taken[*other as usize];
        let mirror = by_delays.get(&key(direction, -1.0)).copied().filter(free).unwrap_or(NO_SLOT);
        if mirror != NO_SLOT {
            taken[mirror as usize] = true;
        }
        pairs.push([direction, mirror]);
    }
    pairs
}

/// The geometry that focusing reads, in rows of the same stride for every sensor.
#[derive(Debug, Default)]
pub(super) struct Geometry {
    /// `[sensor][direction][channel]`: p.u.
    pub along_m: Vec<f32>,
    /// `[sensor][channel]`: |p|^2.
    pub square_m2: Vec<f32>,
    /// `[sensor][direction]`: e.u, |e|^2, 1 where hidden.
    pub emitters: Vec<[f32; 4]>,
    /// `[range]`: the range whose excess it has.
    pub focus_range_m: Vec<f32>,
    /// What CLEAN reads, see `shaders/clean.wgsl`.
    pub clean: Vec<[f32; 4]>,
    /// `[sensor][entry]`.
    pub pulse: Vec<[f32; 4]>,
}

impl Geometry {
    pub(super) fn new(plan: &ImagingPlan) -> Self {
        let Some(focus) = &plan.focus else { return Self::default() };
        let stride = channel_stride(plan);
        let padded = |rows: &[f32], len: usize| -> Vec<f32> {
            let row =
                |row: &[f32]| row.iter().copied().chain(std::iter::repeat_n(0.0, stride - len)).collect::<Vec<f32>>();
            rows.chunks(len).flat_map(row).collect()
        };
        let mut geometry = Self::default();
        for (sensor, focus) in plan.sensors.iter().zip(&focus.sensors) {
            geometry.along_m.extend(padded(&focus.along_m, sensor.channel_count));
            geometry.square_m2.extend(padded(&focus.square_m2, sensor.channel_count));
            let emitter = |(along_m, hidden): (&f32, &bool)| {
                [*along_m, focus.emitter_square_m2, if *hidden { 1.0 } else { 0.0 }, 0.0]
            };
            geometry.emitters.extend(focus.emitter_along_m.iter().zip(&sensor.hidden).map(emitter));
        }
        let of_block = |block: &FocusBlock| std::iter::repeat_n(block.range_m as f32, block.len);
        geometry.focus_range_m = focus.blocks.iter().flat_map(of_block).collect();
        if let Some(clean) = &focus.clean {
            geometry.add_clean(clean, focus, stride);
        }
        geometry
    }

    fn add_clean(&mut self, clean: &CleanPlan, focus: &FocusPlan, stride: usize) {
        let with = |[x, y, z]: [f32; 3], last: f32| [x, y, z, last];
        self.clean.extend(clean.units.iter().map(|unit| with(*unit, 0.0)));
        for (sensor, geometry) in clean.sensors.iter().zip(&focus.sensors) {
            let places =
                sensor.places_m.iter().zip(&geometry.square_m2).map(|(place_m, square)| with(*place_m, *square));
            self.clean.extend(places.chain(std::iter::repeat([0.0; 4])).take(stride));
        }
        for (sensor, geometry) in clean.sensors.iter().zip(&focus.sensors) {
            let [xx, yy, zz, xy, xz, yz] = sensor.lobe;
            self.clean.push(with(geometry.emitter_m, geometry.emitter_square_m2));
            self.clean.push([xx, yy, zz, sensor.slope_per_sample]);
            self.clean.push([xy, xz, yz, 0.0]);
            self.clean.push(sensor.centre);
        }
        self.pulse.extend(clean.sensors.iter().flat_map(|sensor| sensor.pulse.iter()));
    }
}

/// Marks an entry right of the robot's x axis, in its cell; a grid has at most 2^24 of them.
const RIGHT_BIT: u32 = 1 << 31;

/// The mask table as the shader reads it.
#[derive(Debug)]
pub(super) struct MaskEntries {
    /// Cell with the side in its top bit, bits of the distance.
    pub entries: Vec<[u32; 2]>,
    /// Sensor, first entry, count, nothing.
    pub rows: Vec<[u32; 4]>,
    /// `[sensor][range]`: gain, floor, 1 / r^2, sqrt(r).
    pub ranges: Vec<[f32; 4]>,
}

impl MaskEntries {
    /// Says in words what does not fit the plan.
    pub(super) fn new(plan: &ImagingPlan, masks: &MaskTable) -> Result<Self, String> {
        check_masks(plan, masks)?;
        let grid = &plan.grid;
        let entry = |((cell, side), distance_m): ((&u32, &f32), &f32)| {
            // Adding zero makes a negative zero positive: bits compare as distances do.
            [*cell | if *side < 0.0 { RIGHT_BIT } else { 0 }, (distance_m + 0.0).to_bits()]
        };
        let value = |table: &[Vec<f32>], sensor: usize, range: usize, default: f32| {
            table.get(sensor).and_then(|row| row.get(range)).copied().unwrap_or(default)
        };
        let range_entry = |sensor: usize, range: usize| {
            let range_m = grid.range_m(range);
            let (gain, floor) = (value(&masks.gains, sensor, range, 1.0), value(&masks.floors, sensor, range, 0.0));
            // Range zero has no side; the flow layer masks it nowhere.
            let turn = if range_m > 0.0 { range_m.powi(-2) } else { 0.0 };
            [gain, floor, turn as f32, range_m.sqrt() as f32]
        };
        Ok(Self {
            entries: masks.cells.iter().zip(&masks.sides).zip(&masks.distances_m).map(entry).collect(),
            rows: masks
                .rows
                .iter()
                .map(|row| [row.sensor_index as u32, row.first as u32, row.count as u32, 0])
                .collect(),
            ranges: (0..plan.sensors.len())
                .flat_map(|sensor| (0..grid.range_count()).map(move |range| (sensor, range)))
                .map(|(sensor, range)| range_entry(sensor, range))
                .collect(),
        })
    }
}

fn check_masks(plan: &ImagingPlan, masks: &MaskTable) -> Result<(), String> {
    let count = masks.cells.len();
    if masks.sides.len() != count || masks.distances_m.len() != count {
        return Err(format!(
            "the mask table has {count} cells, {} sides, {} distances",
            masks.sides.len(),
            masks.distances_m.len()
        ));
    }
    if let Some(cell) = masks.cells.iter().find(|cell| **cell as usize >= plan.grid.cell_count()) {
        return Err(format!("the mask table names cell {cell}, the grid has {}", plan.grid.cell_count()));
    }
    if let Some(distance_m) = masks.distances_m.iter().find(|distance_m| !(**distance_m >= 0.0)) {
        return Err(format!("the mask table has a distance of {distance_m} m, at least 0 is allowed"));
    }
    let outside = |row: &&crate::signal::MaskRow| {
        row.sensor_index >= plan.sensors.len() || row.first.checked_add(row.count).is_none_or(|end| end > count)
    };
    if let Some(row) = masks.rows.iter().find(outside) {
        return Err(format!(
            "a row of the mask table names sensor {} and {} cells from {}, there are {} sensors and {count} cells",
            row.sensor_index,
            row.count,
            row.first,
            plan.sensors.len()
        ));
    }
    let ranges = plan.grid.range_count();
    let fits = |table: &[Vec<f32>]| {
        table.is_empty() || (table.len() == plan.sensors.len() && table.iter().all(|row| row.len() == ranges))
    };
    if !fits(&masks.gains) || !fits(&masks.floors) {
        return Err(format!("gains and floors of the mask table are not {} rows of {ranges}", plan.sensors.len()));
    }
    Ok(())
}
