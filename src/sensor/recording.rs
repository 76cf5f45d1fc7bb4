//! How the raw data is delivered: `[recording]` of the configuration.

use crate::signal::SampleFormat;
use serde::{Deserialize, Serialize};

/// Format, rate and length of a raw ping, after defaults were filled in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingFormat {
    /// Format of the samples.
    pub format: SampleFormat,
    /// Rate of PDM words or PCM samples.
    pub sample_rate_hz: f64,
    /// PDM words, or PCM samples of one microphone, in a ping.
    pub samples: usize,
    /// PDM words per demodulated sample; 1 for PCM.
    pub decimation: usize,
}

impl RecordingFormat {
    /// Rate after demodulation.
    #[must_use]
    pub fn demodulated_rate_hz(&self) -> f64 {
        self.sample_rate_hz / self.decimation as f64
    }

    /// Samples of one microphone after demodulation.
    #[must_use]
    pub fn demodulated_samples(&self) -> usize {
        self.samples / self.decimation
    }
}
