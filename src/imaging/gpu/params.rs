//! The uniform block of every stage: `#[repr(C)]` twin of `shaders/common/params.wgsl`.
//!
//! In: plan and table sizes. Out: the words that the shaders read; `schedule.rs` adds those of banks and tiles. All are 32 bits wide, so that both layouts agree without
//! padding; tests/shader_layout.rs holds every offset to what naga finds in the shader. Never computes a table.

use super::tables::{BitWindow, PhaseRows};
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use crate::signal::MaskTable;

/// `struct Params` of the shaders; what every field means is written there.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[allow(missing_docs, reason = "each field is described where the shader declares it")]
pub struct Params {
    pub sensor_count: u32,
    pub channel_stride: u32,
    pub raw_stride: u32,
    pub raw_count: u32,
    pub sample_count: u32,
    pub decimation: u32,
    pub bit_block_count: u32,
    pub bit_lead_blocks: u32,
    pub bit_start: u32,
    pub bit_step_count: u32,
    pub demodulation_scale: f32,
    pub phase_stride: u32,
    pub phase_lead: u32,
    pub tap_step_count: u32,
    pub forward_len: u32,
    pub first_bin: u32,
    pub bin_count: u32,
    pub inverse_len: u32,
    pub range_count: u32,
    pub row_count: u32,
    pub phat: u32,
    pub smoothing_count: u32,
    pub cell_stride: u32,
    pub sensor_first: u32,
    pub tile_row_count: u32,
    pub tile_target_first: u32,
    pub quad_first: u32,
    pub slot_first: u32,
    pub row_base: u32,
    pub row_step: u32,
    pub focus_count: u32,
    pub focus_first_bin: u32,
    pub focus_lead: u32,
    pub focus_row_len: u32,
    pub direction_count: u32,
    pub gain_count: u32,
    pub focus_samples_per_m: f32,
    pub focus_turns_per_m: f32,
    pub present: u32,
    pub nonce_low: u32,
    pub nonce_high: u32,
    pub nonce_epoch: u32,
}

/// Name and byte offset of every field, in order: what tests/shader_layout.rs compares with the shader.
pub const PARAMS_LAYOUT: &[(&str, usize)] = &{
    use std::mem::offset_of;
    [
        ("sensor_count", offset_of!(Params, sensor_count)),
        ("channel_stride", offset_of!(Params, channel_stride)),
        ("raw_stride", offset_of!(Params, raw_stride)),
        ("raw_count", offset_of!(Params, raw_count)),
        ("sample_count", offset_of!(Params, sample_count)),
        ("decimation", offset_of!(Params, decimation)),
        ("bit_block_count", offset_of!(Params, bit_block_count)),
        ("bit_lead_blocks", offset_of!(Params, bit_lead_blocks)),
        ("bit_start", offset_of!(Params, bit_start)),
        ("bit_step_count", offset_of!(Params, bit_step_count)),
        ("demodulation_scale", offset_of!(Params, demodulation_scale)),
        ("phase_stride", offset_of!(Params, phase_stride)),
        ("phase_lead", offset_of!(Params, phase_lead)),
        ("tap_step_count", offset_of!(Params, tap_step_count)),
        ("forward_len", offset_of!(Params, forward_len)),
        ("first_bin", offset_of!(Params, first_bin)),
        ("bin_count", offset_of!(Params, bin_count)),
        ("inverse_len", offset_of!(Params, inverse_len)),
        ("range_count", offset_of!(Params, range_count)),
        ("row_count", offset_of!(Params, row_count)),
        ("phat", offset_of!(Params, phat)),
        ("smoothing_count", offset_of!(Params, smoothing_count)),
        ("cell_stride", offset_of!(Params, cell_stride)),
        ("sensor_first", offset_of!(Params, sensor_first)),
        ("tile_row_count", offset_of!(Params, tile_row_count)),
        ("tile_target_first", offset_of!(Params, tile_target_first)),
        ("quad_first", offset_of!(Params, quad_first)),
        ("slot_first", offset_of!(Params, slot_first)),
        ("row_base", offset_of!(Params, row_base)),
        ("row_step", offset_of!(Params, row_step)),
        ("focus_count", offset_of!(Params, focus_count)),
        ("focus_first_bin", offset_of!(Params, focus_first_bin)),
        ("focus_lead", offset_of!(Params, focus_lead)),
        ("focus_row_len", offset_of!(Params, focus_row_len)),
        ("direction_count", offset_of!(Params, direction_count)),
        ("gain_count", offset_of!(Params, gain_count)),
        ("focus_samples_per_m", offset_of!(Params, focus_samples_per_m)),
        ("focus_turns_per_m", offset_of!(Params, focus_turns_per_m)),
        ("present", offset_of!(Params, present)),
        ("nonce_low", offset_of!(Params, nonce_low)),
        ("nonce_high", offset_of!(Params, nonce_high)),
        ("nonce_epoch", offset_of!(Params, nonce_epoch)),
    ]
};

/// Words of the nonce at the end of the result: sequence (low, high), epoch, sensors present.
pub(super) const NONCE_WORDS: usize = 4;

/// Where the parts of the result stand, in 32-bit words: energyscapes in one buffer, sums and nonce in another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ResultLayout {
    /// Cells of one energyscape.
    pub cells: usize,
    /// Sensor s begins at `s * stride`, where a binding may begin.
    pub stride: usize,
    /// All words of the energyscapes.
    pub image: usize,
    /// First word of the nonce, behind the sums.
    pub nonce: usize,
    /// All words of sums and nonce.
    pub sums: usize,
}

impl ResultLayout {
    pub(super) fn new(plan: &ImagingPlan, masks: &MaskTable) -> Self {
        let cells = plan.grid.cell_count();
        let stride = cells.next_multiple_of(BINDING_WORDS);
        let nonce = 8 * masks.rows.len();
        Self { cells, stride, image: stride * plan.sensors.len(), nonce, sums: nonce + NONCE_WORDS }
    }

    /// Bytes of both, one behind the other.
    pub(super) fn bytes(&self) -> u64 {
        4 * (self.image + self.sums) as u64
    }
}

/// A binding begins at a multiple of this many words (256 bytes) on every device.
pub(super) const BINDING_WORDS: usize = 64;

impl Params {
    /// The words of `plan` and `masks`; nothing is present yet. Sizes above `u32` cannot occur: the plan limits them.
    pub(super) fn new(
        plan: &ImagingPlan,
        masks: &MaskTable,
        bits: &BitWindow,
        rows: &PhaseRows,
        raw_stride: usize,
        layout: &ResultLayout,
    ) -> Self {
        Self {
            sensor_count: plan.sensors.len() as u32,
            channel_stride: channel_stride(plan) as u32,
            raw_stride: raw_stride as u32,
            raw_count: plan.raw_count as u32,
            sample_count: plan.sample_count as u32,
            decimation: plan.decimation as u32,
            bit_block_count: bits.block_count as u32,
            bit_lead_blocks: bits.lead_blocks as u32,
            bit_start: bits.start as u32,
            bit_step_count: bits.step_count as u32,
            demodulation_scale: bits.scale,
            phase_stride: rows.stride as u32,
            phase_lead: rows.lead as u32,
            tap_step_count: rows.tap_step_count as u32,
            forward_len: plan.forward_len as u32,
            first_bin: plan.first_bin as u32,
            bin_count: plan.bin_count as u32,
            inverse_len: plan.inverse_len as u32,
            range_count: plan.grid.range_count() as u32,
            row_count: masks.rows.len() as u32,
            phat: u32::from(plan.phat),
            smoothing_count: plan.smoothing_taps.len() as u32,
            cell_stride: layout.stride as u32,
            direction_count: plan.grid.direction_count() as u32,
            gain_count: (plan.sensors.len() * channel_stride(plan)) as u32,
            ..plan.focus.as_ref().map_or_else(Self::default, |focus| Self::of_focus(plan, focus))
        }
    }

    fn of_focus(plan: &ImagingPlan, focus: &FocusPlan) -> Self {
        let len = focus.signal_len;
        Self {
            focus_count: focus.range_count as u32,
            focus_first_bin: ((plan.first_bin + len - focus.centre_bin % len) % len) as u32,
            focus_lead: focus.lead as u32,
            focus_row_len: focus.row_len as u32,
            focus_samples_per_m: focus.samples_per_m as f32,
            focus_turns_per_m: focus.turns_per_m as f32,
            ..Self::default()
        }
    }

    /// The nonce that the last kernel copies behind the sums.
    pub(super) fn set_nonce(&mut self, [low, high, epoch, present]: [u32; NONCE_WORDS]) {
        (self.nonce_low, self.nonce_high, self.nonce_epoch, self.present) = (low, high, epoch, present);
    }
}

/// Rows that every sensor has in per-channel buffers.
pub(super) fn channel_stride(plan: &ImagingPlan) -> usize {
    plan.sensors.iter().map(|sensor| sensor.channel_count).max().unwrap_or(1)
}
