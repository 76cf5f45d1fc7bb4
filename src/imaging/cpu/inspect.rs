//! Outputs of single stages in the order of the textbook, for tests and for finding faults. Slow, and allocates.
//!
//! In: the buffers of [`Work`] after a phase. Out: `[channel][sample]`, `[channel][bin]`, `[direction][bin]`.

use super::aligned::Aligned;
use super::delay_and_sum::{self, Fold};
use super::tile::full_scale;
use super::work::{Piece, Work, reading};
use crate::signal::Samples;

impl Work {
    /// Demodulated samples of a sensor, `[channel][sample]`, zeros for a channel without gain.
    pub(super) fn demodulated_of(&self, sensor: usize, gains: &[f32], samples: &Samples) -> Vec<f32> {
        let count = self.plan.sample_count;
        let mut output = vec![0.0; gains.len() * count];
        let used = output.chunks_exact_mut(count).enumerate().filter(|(channel, _)| gains[*channel] != 0.0);
        for (channel, row) in used {
            let raw = channel * self.plan.raw_count..(channel + 1) * self.plan.raw_count;
            match samples {
                Samples::PcmF32(values) => row.copy_from_slice(&values[raw]),
                Samples::PcmI16(values) => {
                    row.iter_mut().zip(&values[raw]).for_each(|(sample, value)| *sample = full_scale(*value));
                }
                Samples::Pdm(_) => {
                    for (from, pcm) in self.demodulated.iter().zip(&self.pcm).filter(|(from, _)| from.sensor == sensor)
                    {
                        let first = channel / self.lanes * self.bit_filter.padded(from.range.len());
                        let pcm = &reading(pcm)[first * self.lanes + channel % self.lanes..];
                        for (sample, value) in row[from.range.clone()].iter_mut().zip(pcm.iter().step_by(self.lanes)) {
                            *sample = *value;
                        }
                    }
                }
            }
        }
        output
    }

    /// Band spectra of a sensor's channels, `[channel][bin]`.
    pub(super) fn spectra_of(&self, sensor: usize) -> Vec<[f32; 2]> {
        let mut output = Vec::new();
        for channel in 0..self.plan.sensors[sensor].channel_count {
            let of_block = |piece: &Piece| piece.sensor == sensor && piece.block == channel / self.lanes;
            let Some(index) = self.transformed.iter().position(of_block) else { continue };
            let lane = channel % self.lanes;
            let pairs = reading(&self.spectra[index]);
            output.extend(pairs.chunks_exact(2 * self.lanes).map(|pair| [pair[lane], pair[self.lanes + lane]]));
        }
        output
    }

    /// Band spectra of a sensor's beams, `[direction][bin]`: steered anew, into a place a bin.
    pub(super) fn beams_of(&self, sensor: usize) -> Vec<[f32; 2]> {
        let bins = self.plan.bin_count;
        let fold = Fold { places: (0..bins as u32).collect(), fresh: bins, gaps: Vec::new(), len: bins };
        let mut output = vec![[0.0; 2]; self.plan.grid.direction_count() * bins];
        let Some(group) = self.groups.iter().find(|group| group.sensors.contains(&sensor)) else { return output };
        let mut phases = Aligned::zeros(delay_and_sum::scratch_len(group.steering.channel_count(), self.lanes));
        let mut beams = Aligned::zeros(4 * bins * self.lanes);
        for lane_block in 0..group.lane_blocks {
            self.steer(group, lane_block, &[sensor], &fold, &mut phases, &mut beams);
            let (direct, mirrored) = beams.split_at(2 * bins * self.lanes);
            for (lane, (direction, mirror)) in group.steering.lanes(lane_block, self.lanes).iter().enumerate() {
                for (direction, values) in [(Some(*direction), direct), (*mirror, mirrored)] {
                    let Some(direction) = direction else { continue };
                    let pairs = values.chunks_exact(2 * self.lanes).map(|pair| [pair[self.lanes + lane], pair[lane]]);
                    output[direction * bins..][..bins].iter_mut().zip(pairs).for_each(|(to, pair)| *to = pair);
                }
            }
        }
        output
    }
}
