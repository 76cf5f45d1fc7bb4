//! Outputs of single stages in the order of the textbook, for tests and for finding faults. Slow, and allocates.
//!
//! In: a backend whose samples are uploaded. Out: `[channel][sample]`, `[channel][bin]`, `[direction][bin]`, `[direction][range]`.

use super::params::channel_stride;
use super::program::Step;
use super::readback::Staging;
use super::resource::Resource;
use super::{GpuBackend, SLOW_LIMIT};
use crate::imaging::backend::{BackendError, Stage};
use crate::signal::SENSORS_MAX;
use std::time::Instant;

impl GpuBackend {
    /// A part of a buffer after the dispatches that are wanted, as words.
    fn words_after(
        &mut self,
        wanted: impl Fn(&Step) -> bool,
        resource: Resource,
        first: usize,
        count: usize,
    ) -> Result<Vec<u32>, BackendError> {
        let start = Instant::now();
        let bytes = 4 * count.max(1) as u64;
        let mut staging = Staging::new(&self.gpu, bytes);
        let mut encoder = self.encode(None, wanted);
        encoder.copy_buffer_to_buffer(self.program.buffer(resource), 4 * first as u64, &staging.buffer, 0, bytes);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.faults.check()?;
        staging.request();
        staging.wait(&self.gpu, start, SLOW_LIMIT)?;
        staging.read(|bytes| Ok(bytemuck::pod_collect_to_vec(bytes)))
    }

    /// PCM of a sensor, put back from phase rows into `[channel][sample]`.
    pub(super) fn demodulated(&mut self, sensor: usize) -> Result<Vec<f32>, BackendError> {
        let (phases, row_len, lead) = (self.plan.band_decimation, self.program.rows.stride, self.program.rows.lead);
        let rows = channel_stride(&self.plan) * phases;
        let bank = self.program.bank_of(sensor);
        let first = (sensor - self.program.banks[bank].sensors.start) * rows * row_len;
        let wanted = |step: &Step| step.bank == bank && step.stage == Stage::Demodulate;
        let words = self.words_after(wanted, Resource::Pcm, first, rows * row_len)?;
        let channels = self.plan.sensors[sensor].channel_count;
        let value = |channel: usize, n: usize| words[(channel * phases + n % phases) * row_len + lead + n / phases];
        let samples = self.plan.sample_count;
        Ok((0..channels)
            .flat_map(|channel| (0..samples).map(move |n| (channel, n)))
            .map(|(channel, n)| f32::from_bits(value(channel, n)))
            .collect())
    }

    /// Spectra of a sensor's channels.
    pub(super) fn matched(&mut self, sensor: usize) -> Result<Vec<[f32; 2]>, BackendError> {
        let bins = self.plan.bin_count;
        let bank = self.program.bank_of(sensor);
        let row = (sensor - self.program.banks[bank].sensors.start) * channel_stride(&self.plan);
        let rows = self.plan.sensors[sensor].channel_count;
        let wanted = |step: &Step| step.bank == bank && step.stage <= Stage::MatchedFilter;
        Ok(complex(&self.words_after(wanted, Resource::Spectra, 2 * bins * row, 2 * bins * rows)?))
    }

    /// Energyscape of a sensor before its near ranges are focused.
    pub(super) fn plane_waves(&mut self, sensor: usize) -> Result<Vec<f32>, BackendError> {
        let (first, cells) = (sensor * self.layout.stride, self.layout.cells);
        let words = self.words_after(|step| step.stage <= Stage::Envelope, Resource::Image, first, cells)?;
        Ok(words.into_iter().map(f32::from_bits).collect())
    }

    /// Spectra of a sensor's directions, put back from the rows of the tiles.
    pub(super) fn summed(&mut self, sensor: usize) -> Result<Vec<[f32; 2]>, BackendError> {
        let (bins, ranges) = (self.plan.bin_count, self.plan.grid.range_count());
        let bank = self.program.bank_of(sensor);
        let local = sensor - self.program.banks[bank].sensors.start;
        let mut spectra = vec![[0.0; 2]; self.plan.grid.direction_count() * bins];
        for index in 0..self.program.tiles.len() {
            let tile = self.program.tiles[index].clone();
            if tile.bank != bank {
                continue;
            }
            let before = |step: &Step| step.bank == bank && step.stage <= Stage::MatchedFilter;
            let wanted = |step: &Step| before(step) || (step.stage == Stage::DelayAndSum && step.tile == Some(index));
            let rows = complex(&self.words_after(wanted, Resource::WorkA, 0, 2 * bins * tile.row_count)?);
            let targets = &self.program.targets[tile.target_first..][..tile.row_count];
            for (row, [cell, flags]) in rows.chunks_exact(bins).zip(targets) {
                if *flags as usize & (SENSORS_MAX.next_power_of_two() - 1) == local {
                    let direction = (*cell as usize - local * self.layout.stride) / ranges;
                    spectra[direction * bins..][..bins].copy_from_slice(row);
                }
            }
        }
        Ok(spectra)
    }
}

fn complex(words: &[u32]) -> Vec<[f32; 2]> {
    words.chunks_exact(2).map(|pair| [f32::from_bits(pair[0]), f32::from_bits(pair[1])]).collect()
}
