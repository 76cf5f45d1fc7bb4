//! What the kernels of a ping set move and compute: the counted work of this backend, not the least that would do
//! (`plan/floor.rs` counts that).
//!
//! In: the dispatches of a blueprint, all sensors present. Out: per dispatch workgroups, threads, bytes through the device's memory if
//! no cache held anything from one dispatch to the next, and arithmetic instructions, a multiply-add being one. Bytes that
//! lanes share, and tables that every workgroup reads, count once a dispatch. Never touches a device, never measures.

use super::params::{ResultLayout, channel_stride};
use super::schedule::{BINDING_BYTES_MAX, Blueprint, Dispatch};
use crate::imaging::backend::{BackendError, Stage};
use crate::imaging::plan::ImagingPlan;
use crate::imaging::plan::focus::TAPS;
use crate::signal::{MaskTable, SampleFormat};
use std::ops::Range;

/// Instructions of `cos_sin`, counted in the shader: folding 8, two polynomials 10.
const COS_SIN: u64 = 18;

/// The work of one dispatch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DispatchWork {
    /// The stage that it is a part of.
    pub stage: Stage,
    /// Workgroups: what a GPU has to spread over its cores.
    pub workgroups: u64,
    /// Threads that have something to do.
    pub threads: u64,
    /// Arithmetic instructions.
    pub operations: u64,
    /// Bytes read and written.
    pub bytes: u64,
}

/// Buffers of a backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// All buffers of the device, without the ones for reading back and poisoning.
    pub buffer_bytes: u64,
    /// The largest part of a buffer that a kernel sees.
    pub largest_binding_bytes: u64,
    /// Parts that sensors and directions are cut into.
    pub bank_count: usize,
    /// As above.
    pub tile_count: usize,
}

/// A pipeline that the backend builds.
#[derive(Debug, Clone, PartialEq)]
pub struct PipelineUse {
    /// Its stage, whose shader holds it.
    pub stage: Stage,
    /// Entry point.
    pub entry_point: &'static str,
    /// Pipeline constants.
    pub constants: Vec<(&'static str, f64)>,
}

/// What the buffers of this plan take.
///
/// # Errors
/// [`BackendError::Unavailable`] where the plan cannot be done on a GPU at all.
pub fn memory(plan: &ImagingPlan, masks: &MaskTable) -> Result<Memory, BackendError> {
    let blueprint = Blueprint::new(plan, masks, BINDING_BYTES_MAX)?;
    Ok(Memory {
        buffer_bytes: super::resource::Resource::ALL.iter().map(|resource| blueprint.bytes(*resource)).sum(),
        largest_binding_bytes: blueprint.needs().binding_bytes,
        bank_count: blueprint.banks.len(),
        tile_count: blueprint.tiles.len(),
    })
}

/// Every pipeline of this plan, each once.
///
/// # Errors
/// As [`memory`].
pub fn pipelines(plan: &ImagingPlan, masks: &MaskTable) -> Result<Vec<PipelineUse>, BackendError> {
    let mut uses = Vec::new();
    for dispatch in Blueprint::new(plan, masks, BINDING_BYTES_MAX)?.dispatches {
        let Dispatch { kernel, constants, .. } = dispatch;
        let one = PipelineUse { stage: kernel.stage, entry_point: kernel.entry_point, constants };
        if !uses.contains(&one) {
            uses.push(one);
        }
    }
    Ok(uses)
}

/// Bytes that every ping set moves to the device, its samples, and back from it, energyscapes and sums.
#[must_use]
pub fn transfer_bytes(plan: &ImagingPlan, masks: &MaskTable) -> (u64, u64) {
    (raw_bytes(plan, 0..plan.sensors.len()), ResultLayout::new(plan, masks).bytes())
}

fn raw_bytes(plan: &ImagingPlan, sensors: Range<usize>) -> u64 {
    let sample = match plan.format {
        SampleFormat::PcmI16 => 2,
        SampleFormat::Pdm | SampleFormat::PcmF32 => 4,
    };
    sensors.map(|sensor| sample * plan.raw_len(sensor) as u64).sum()
}

/// The work of every dispatch, in order.
///
/// # Errors
/// As [`memory`].
pub fn workload(plan: &ImagingPlan, masks: &MaskTable) -> Result<Vec<DispatchWork>, BackendError> {
    let blueprint = Blueprint::new(plan, masks, BINDING_BYTES_MAX)?;
    let one = |dispatch: &Dispatch| {
        let (operations, bytes) = count(&blueprint, dispatch, masks.cells.len() as u64);
        let workgroups = dispatch.groups().iter().map(|groups| u64::from(*groups)).product();
        DispatchWork { stage: dispatch.kernel.stage, workgroups, threads: threads(dispatch), operations, bytes }
    };
    Ok(blueprint.dispatches.iter().map(one).collect())
}

fn threads(dispatch: &Dispatch) -> u64 {
    dispatch.threads.iter().map(|threads| u64::from(*threads)).product()
}

/// Instructions and bytes of a dispatch.
fn count(blueprint: &Blueprint<'_>, dispatch: &Dispatch, entries: u64) -> (u64, u64) {
    let plan = blueprint.plan;
    let (threads, sensors) = (threads(dispatch), blueprint.banks[dispatch.bank].sensors.len());
    let channels = (sensors * channel_stride(plan)) as u64;
    let rows = dispatch.tile.map_or(0, |tile| blueprint.tiles[tile].row_count) as u64;
    let constant = |name: &str| {
        dispatch.constants.iter().find(|(known, _)| *known == name).map_or(0.0, |(_, value)| *value) as u64
    };
    let (bins, ranges, samples) = (plan.bin_count as u64, plan.grid.range_count() as u64, plan.sample_count as u64);
    let raw = raw_bytes(plan, blueprint.banks[dispatch.bank].sensors.clone());
    let streams = 4 * channels * blueprint.bits.block_count as u64;
    let (forward, inverse) = (8 * channels * plan.forward_len as u64, 8 * rows * plan.inverse_len as u64);
    let (signals, kept) = plan.focus.as_ref().map_or((0, 0), |focus| {
        let row = focus.oversampling * focus.row_len;
        (8 * channels * focus.signal_len as u64, 8 * channels * row as u64)
    });
    let butterfly =
        || threads * butterfly_operations(constant("RADIX_ROWS"), constant("RADIX_COLUMNS"), constant("SPAN"));
    match dispatch.kernel.entry_point {
        // 80 exchanges of six instructions, and the addresses of 32 loads and stores.
        "transpose_words" => (threads * 640, raw + streams),
        "demodulate_pdm" => {
            let tables = 16 * (blueprint.bits.sums.len() + blueprint.bits.corrections.len()) as u64;
            // A lookup is an address of three instructions and four additions.
            (threads * (28 * blueprint.bits.step_count as u64 + 40), streams + tables + 4 * channels * samples)
        }
        "demodulate_i16" | "demodulate_f32" => (threads * 50, raw + 4 * channels * samples),
        "band_filter" => {
            let products = 64 * plan.band_decimation * blueprint.rows.tap_step_count;
            let taps = 16 * blueprint.rows.taps.len() as u64;
            (threads * products as u64, 4 * channels * samples + taps + forward)
        }
        "forward_pass" => (butterfly(), 2 * forward),
        "forward_last" => (butterfly() + 6 * channels * bins, forward + 8 * (channels + 1) * bins),
        "delay_and_sum" => {
            let sensors = constant("SENSORS");
            let one = 4 * COS_SIN + 4 + 16 * sensors;
            let quads = u64::from(dispatch.threads[1]);
            let part = 8 * quads.min(rows) * sensors;
            let bytes = 8 * sensors * constant("CHANNELS") * bins + 16 * quads * constant("CHANNELS");
            (threads * constant("CHANNELS") * one, bytes + 8 * part.min(rows) * bins)
        }
        "inverse_first" => (butterfly(), 8 * rows * bins + inverse),
        "inverse_pass" => (butterfly(), 2 * inverse),
        "inverse_last" => (butterfly() + 3 * rows * ranges, inverse + 4 * rows * ranges),
        "inverse_last_whole" => (butterfly() + inverse, inverse + inverse / 2),
        "smooth_rows" => (2 * threads * plan.smoothing_taps.len() as u64, inverse / 2 + 4 * rows * ranges),
        "signal_first" => (butterfly(), 8 * channels * bins + signals),
        "signal_pass" => (butterfly(), 2 * signals),
        "signal_last" => (butterfly(), signals + kept),
        name @ ("focus" | "focus_sums") => {
            let cells = if name == "focus" { 1 } else { 4 };
            let readings = threads * channel_stride(plan) as u64;
            let geometry =
                4 * cells * readings / plan.focus.as_ref().map_or(1, |focus| focus.range_count as u64).max(1);
            // The way, its phase, three vectors of taps, ten readings of two values; samples come from a cache but once.
            (readings * (30 + COS_SIN + 24 + cells * 4 * TAPS as u64), kept + geometry + 4 * cells * threads)
        }
        // Twice an entry and its cell; the gains of a range stay in a cache.
        _ => (40 * entries, 24 * entries),
    }
}

/// Instructions of one thread of a pass: both small transforms, the turns between them, and those of the inputs.
fn butterfly_operations(rows: u64, columns: u64, span: u64) -> u64 {
    let dft = |size: u64| match size {
        2 => 4,
        3 => 14,
        4 => 16,
        5 => 40,
        7 => 84,
        _ => 0,
    };
    let turns = if span > 1 { (rows * columns - 1) * (COS_SIN + 4) } else { 0 };
    columns * dft(rows) + rows * dft(columns) + 4 * (rows - 1) * (columns - 1) + turns
}
