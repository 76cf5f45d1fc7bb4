//! How the raw data is delivered: `[recording]` of the configuration.
//!
//! Goes in: the keys that a person wrote. Comes out: format, rate, length and decimation with the format's defaults filled
//! in. The number of channels is the array's and not known here.

use crate::parameter::{ParameterError, check_range};
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
    /// What the eRTIS delivers in `format`.
    #[must_use]
    pub fn of(format: SampleFormat) -> Self {
        match format {
            SampleFormat::Pdm => Self { format, sample_rate_hz: 4.5e6, samples: 163_840, decimation: 10 },
            SampleFormat::PcmI16 | SampleFormat::PcmF32 => {
                Self { format, sample_rate_hz: 450e3, samples: 16_384, decimation: 1 }
            }
        }
    }

    /// Time that a ping lasts.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.samples as f64 / self.sample_rate_hz
    }

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

/// Most PDM words or PCM samples of one microphone in a ping: a second at 16 MHz.
const SAMPLES_MAX: usize = 1 << 24;
/// Largest decimation.
const DECIMATION_MAX: usize = 1000;

/// `[recording]` as written; what is left out follows from the format.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingParams {
    /// Format of the samples.
    pub format: SampleFormat,
    /// Rate of PDM words or PCM samples: 4.5 MHz and 450 kHz by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_rate_hz: Option<f64>,
    /// PDM words, or PCM samples of one microphone, in a ping: 163,840 and 16,384 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<usize>,
    /// PDM words per demodulated sample, 10 by default; PDM only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimation: Option<usize>,
}

impl Default for RecordingParams {
    fn default() -> Self {
        Self { format: SampleFormat::Pdm, sample_rate_hz: None, samples: None, decimation: None }
    }
}

impl RecordingParams {
    /// The format with its defaults filled in.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[recording]`.
    pub fn resolve(&self) -> Result<RecordingFormat, ParameterError> {
        let default = RecordingFormat::of(self.format);
        let recording = RecordingFormat {
            format: self.format,
            sample_rate_hz: self.sample_rate_hz.unwrap_or(default.sample_rate_hz),
            samples: self.samples.unwrap_or(default.samples),
            decimation: self.decimation.unwrap_or(default.decimation),
        };
        check_range("sample_rate_hz", recording.sample_rate_hz, 1e3, 1e8)?;
        let decimation_max = if self.format == SampleFormat::Pdm { DECIMATION_MAX } else { 1 };
        if !(1..=decimation_max).contains(&recording.decimation) {
            let allowed = match self.format {
                SampleFormat::Pdm => format!("a whole number from 1 to {DECIMATION_MAX}"),
                _ => "no decimation: PCM is taken at its own rate".to_owned(),
            };
            return Err(ParameterError::new("decimation", recording.decimation, allowed));
        }
        if !(2 * recording.decimation..=SAMPLES_MAX).contains(&recording.samples) {
            let allowed = format!("a whole number from {} to {SAMPLES_MAX}", 2 * recording.decimation);
            return Err(ParameterError::new("samples", recording.samples, allowed));
        }
        Ok(recording)
    }
}
