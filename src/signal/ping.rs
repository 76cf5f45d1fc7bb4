//! Raw pings: the microphone samples of one sensor for one emission, and the synchronised set of them.

use crate::time::Stamp;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Most sensors that one robot carries here.
pub const SENSORS_MAX: usize = 3;

/// How the microphones' samples are delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SampleFormat {
    /// One little-endian `u32` word a sample period, bit k = microphone k.
    Pdm,
    /// `[microphones][samples]` of `i16`, full scale 32768.
    PcmI16,
    /// `[microphones][samples]` of `f32`, full scale 1.
    PcmF32,
}

impl SampleFormat {
    /// The name as the configuration writes it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            SampleFormat::Pdm => "pdm",
            SampleFormat::PcmI16 => "pcm-i16",
            SampleFormat::PcmF32 => "pcm-f32",
        }
    }
}

/// Samples of one ping, all microphones. PCM is row-major `[microphones][samples]`.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// PDM words, one a sample period.
    Pdm(Vec<u32>),
    /// 16-bit PCM.
    PcmI16(Vec<i16>),
    /// 32-bit float PCM.
    PcmF32(Vec<f32>),
}

impl Samples {
    /// Zeros in `format`; `len` counts words (PDM) or `microphones * samples` (PCM).
    #[must_use]
    pub fn zeros(format: SampleFormat, len: usize) -> Self {
        match format {
            SampleFormat::Pdm => Samples::Pdm(vec![0; len]),
            SampleFormat::PcmI16 => Samples::PcmI16(vec![0; len]),
            SampleFormat::PcmF32 => Samples::PcmF32(vec![0.0; len]),
        }
    }

    /// The format of these samples.
    #[must_use]
    pub fn format(&self) -> SampleFormat {
        match self {
            Samples::Pdm(_) => SampleFormat::Pdm,
            Samples::PcmI16(_) => SampleFormat::PcmI16,
            Samples::PcmF32(_) => SampleFormat::PcmF32,
        }
    }

    /// Number of words (PDM) or of values over all microphones (PCM).
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Samples::Pdm(words) => words.len(),
            Samples::PcmI16(values) => values.len(),
            Samples::PcmF32(values) => values.len(),
        }
    }

    /// Whether there is no sample at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Everything one sensor heard of one emission.
#[derive(Debug, Clone, PartialEq)]
pub struct RawPing {
    /// Index of the sensor in the configuration.
    pub sensor_index: usize,
    /// The sensor's own running number.
    pub sequence: u64,
    /// Time of sample 0, the first sample of the emission.
    pub emitted_at: Stamp,
    /// The samples. Shared, so that the threads that image a ping read it where it lies.
    pub samples: Arc<Samples>,
}

impl RawPing {
    /// When its set was triggered: sensors that fire in turn do so `slot_ns` after one another, in the order of the configuration; zero
    /// where all fire together.
    #[must_use]
    pub fn trigger_ns(&self, slot_ns: u64) -> u64 {
        self.emitted_at.boottime_ns.saturating_sub(slot_ns.saturating_mul(self.sensor_index as u64))
    }

    /// The samples, to be written. Copies them first where somebody else still reads them, which happens only after a fault.
    pub fn samples_mut(&mut self) -> &mut Samples {
        Arc::make_mut(&mut self.samples)
    }
}

/// The pings of one emission of all sensors. A sensor that did not deliver in time has `present[i] == false`; its
/// buffer is kept, so that a set can be filled again without allocating.
#[derive(Debug, Clone, PartialEq)]
pub struct PingSet {
    /// Running number of the set.
    pub sequence: u64,
    /// The oldest emission time of the pings present: what ages are judged by.
    pub emitted_at: Stamp,
    /// One slot a configured sensor, in the order of the configuration.
    pub pings: Vec<RawPing>,
    /// Which slots hold a ping of this set.
    pub present: [bool; SENSORS_MAX],
}

impl PingSet {
    /// An empty set with buffers of `len` values (see [`Samples::zeros`]) for each of `sensor_count` sensors.
    ///
    /// # Panics
    /// If `sensor_count` is zero or above [`SENSORS_MAX`].
    #[must_use]
    pub fn empty(sensor_count: usize, format: SampleFormat, len: &[usize]) -> Self {
        assert!((1..=SENSORS_MAX).contains(&sensor_count), "1 to {SENSORS_MAX} sensors, not {sensor_count}");
        assert_eq!(len.len(), sensor_count, "one length a sensor");
        let pings = (0..sensor_count)
            .map(|sensor_index| RawPing {
                sensor_index,
                sequence: 0,
                emitted_at: Stamp::default(),
                samples: Arc::new(Samples::zeros(format, len[sensor_index])),
            })
            .collect();
        Self { sequence: 0, emitted_at: Stamp::default(), pings, present: [false; SENSORS_MAX] }
    }

    /// The pings that are present.
    pub fn iter_present(&self) -> impl Iterator<Item = &RawPing> {
        self.pings.iter().zip(self.present).filter_map(|(ping, present)| present.then_some(ping))
    }
}
