//! Every size, offset and table of the imaging, made once in f64 and shared by both twins.
//!
//! The whole of sections 2 and 3 of the specification after demodulation is linear up to the magnitude, so it is done
//! on the band only, as a complex baseband:
//!
//! 1. a complex band-pass FIR keeps the positive frequencies of the band and decimates by D (band-pass sampling);
//! 2. a transform of length N1 = N / D: index k mod N1 is the spectrum at f_k = k fs / N, for the K bins of the band;
//! 3. times `reference[k]` = 2 P(f_k) conj(S(f_k)) exp(j 2 pi f_k t_0) / (G(f_k) sum s^2 N), with P the passband, S the emission's
//!    spectrum, G the FIR's own response (so that it cancels exactly) and t_0 = 2 range_first / c;
//! 4. per direction the sum over channels of spectrum times exp(-j 2 pi f_k p.u / c);
//! 5. folded into M bins (index k mod M: sampling every T / M aliases nothing else, since only those instants are asked
//!    for) and transformed back: the analytic signal at t_0 + i T / M, whose magnitude is the envelope, with T = N / fs.

use crate::signal::{PolarGrid, SampleFormat};
use std::sync::Arc;

/// Sizes and tables for all sensors. Sensors share everything but array, steering and dead zones.
#[derive(Debug, Clone)]
pub struct ImagingPlan {
    /// Format of the raw samples.
    pub format: SampleFormat,
    /// PDM words or PCM samples of one channel in a ping.
    pub raw_count: usize,
    /// PDM words per sample; 1 for PCM.
    pub decimation: usize,
    /// Real, symmetric low-pass FIR on PDM bits (+1, -1), odd length, unit gain at DC; empty for PCM. Sample j is centred on word
    /// `j * decimation`; words outside the ping count as zero.
    pub demodulation_taps: Vec<f32>,
    /// Demodulated samples of one channel, Ns.
    pub sample_count: usize,
    /// Their rate fs.
    pub sample_rate_hz: f64,
    /// D.
    pub band_decimation: usize,
    /// Complex band-pass FIR, odd length; output j = sum over i of taps[i] * x[(j D + i - half) mod N], x zero beyond `sample_count`.
    pub band_taps: Vec<[f32; 2]>,
    /// N1: outputs of the FIR and length of the forward transform. N = N1 * D.
    pub forward_len: usize,
    /// k of the first bin of the band.
    pub first_bin: usize,
    /// K: bins in the band.
    pub bin_count: usize,
    /// Frequency of bin k is k times this.
    pub bin_step_hz: f64,
    /// `[bin]`, see the module's header.
    pub reference: Vec<[f32; 2]>,
    /// M: length of the inverse transform.
    pub inverse_len: usize,
    /// Weighting of every bin to unit magnitude before the passband (PHAT).
    pub phat: bool,
    /// Smoothing FIR along range on the magnitude, odd length, unit sum; empty when off.
    pub smoothing_taps: Vec<f32>,
    /// The published grid: ranges of the first `range_count` outputs of the inverse transform.
    pub grid: Arc<PolarGrid>,
    /// What differs between sensors.
    pub sensors: Vec<SensorPlan>,
}

/// What differs between sensors.
#[derive(Debug, Clone)]
pub struct SensorPlan {
    /// Channels in the raw data, disabled ones included.
    pub channel_count: usize,
    /// Apodization weight of each channel, zero where disabled.
    pub weights: Vec<f32>,
    /// `[direction][channel]`: p.u / c, by how much the channel hears a wave from the direction earlier than the origin.
    pub delays_s: Arc<Vec<f64>>,
    /// Directions hidden by housings or obstructions: their cells are zero.
    pub hidden: Vec<bool>,
    /// Index of the first sensor with the same delays: steering is shared with it.
    pub steering_of: usize,
    /// Time after which clipping counts: end of the emission + 2 ms.
    pub clip_after_s: f64,
}
