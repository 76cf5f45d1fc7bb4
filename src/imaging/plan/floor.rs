//! The counted floor of each stage: the arithmetic and the memory traffic that the plan itself asks for, whatever the backend.
//!
//! In: a plan and the size of the mask table. Out: operations and bytes a stage for one ping set of all sensors, to be held beside
//! measured times. An operation is one real multiply-add, or one of the two where it stands alone. Phases are taken as
//! given: making them is a backend's own affair.

use super::ImagingPlan;
use super::focus::TAPS;
use crate::imaging::backend::Stage;
use crate::signal::SampleFormat;

/// What a stage cannot do without.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageFloor {
    /// Real multiply-adds.
    pub operations: u64,
    /// Bytes read once and written once, tables left out.
    pub bytes: u64,
}

impl ImagingPlan {
    /// Floor of each stage in the order of [`Stage::ALL`]; `mask_entries` is the number of cells in the mask table.
    #[must_use]
    pub fn floor(&self, mask_entries: usize) -> [StageFloor; Stage::ALL.len()] {
        Stage::ALL.map(|stage| self.stage_floor(stage, mask_entries))
    }

    fn stage_floor(&self, stage: Stage, mask_entries: usize) -> StageFloor {
        let sensors = self.sensors.len();
        let channels: usize = self.sensors.iter().map(|sensor| sensor.channel_count).sum();
        let directions = sensors * self.grid.direction_count();
        let cells = sensors * self.grid.cell_count();
        let raw: usize = (0..sensors).map(|sensor| self.raw_len(sensor) * self.sample_bytes()).sum();
        // Radix-2 count of a complex transform: 5 n log2 n operations, of which 2 n log2 n fit into multiply-adds.
        let transform = |len: usize| (3.0 * len as f64 * (len as f64).log2()) as usize;
        let complex = 8;
        let (operations, bytes) = match (stage, self.format) {
            (Stage::Demodulate, SampleFormat::Pdm) => {
                let samples = channels * self.sample_count;
                (samples * self.demodulation_taps.len(), raw + 4 * samples)
            }
            (Stage::Demodulate, _) => (0, 0),
            (Stage::MatchedFilter, format) => {
                let filter = 2 * self.forward_len * self.band_taps.len();
                let read = if format == SampleFormat::Pdm { 4 * channels * self.sample_count } else { raw };
                let spectra = channels * self.bin_count;
                (channels * (filter + transform(self.forward_len)) + 4 * spectra, read + complex * spectra)
            }
            (Stage::DelayAndSum, _) => {
                let products: usize = self.sensors.iter().map(|s| s.channel_count * self.grid.direction_count()).sum();
                // Two for each real product and not four: opposite directions of a planar array share them.
                (2 * products * self.bin_count, complex * (channels + directions) * self.bin_count)
            }
            (Stage::Envelope, _) => {
                let smoothing = cells * self.smoothing_taps.len();
                let operations = directions * transform(self.inverse_len) + 3 * cells + smoothing;
                (operations, complex * directions * self.bin_count + 4 * cells)
            }
            (Stage::Focus, _) => self.focus.as_ref().map_or((0, 0), |focus| {
                let samples = channels * focus.oversampling * focus.row_len;
                let cells = directions * focus.range_count;
                let readings: usize = self.sensors.iter().map(|s| s.channel_count).sum::<usize>()
                    * self.grid.direction_count()
                    * focus.range_count;
                // A reading is interpolated, turned and added.
                let operations = channels * transform(focus.signal_len) + (2 * TAPS + 4) * readings + 3 * cells;
                (operations, complex * (channels * self.bin_count + samples) + 4 * cells)
            }),
            // Entry: cell, side, distance; its energy twice, for the peak and for the nearest.
            (Stage::MaskedEnergy, _) => (2 * cells + 5 * mask_entries, 4 * cells + 20 * mask_entries),
        };
        StageFloor { operations: operations as u64, bytes: bytes as u64 }
    }

    fn sample_bytes(&self) -> usize {
        match self.format {
            SampleFormat::Pdm | SampleFormat::PcmF32 => 4,
            SampleFormat::PcmI16 => 2,
        }
    }
}
