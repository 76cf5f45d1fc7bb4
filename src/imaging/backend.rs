//! The seam between the imaging twins: what a backend is given, what it gives back, how it fails.
//!
//! Imported by both twins; knows neither of them. The plan it works to is [`super::plan::ImagingPlan`].

use super::channels::ChannelReport;
use super::plan::ImagingPlan;
use crate::signal::{Energyscape, MaskTable, PingSet, RowSums, SENSORS_MAX};
use crate::time::Stamp;
use std::sync::Arc;

/// The stages, in order. The names are file stems, shader stems and bench ids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Stage {
    /// PDM or PCM to `f32` PCM, `[channel][sample]`.
    Demodulate,
    /// PCM to the matched-filtered band spectrum, complex `[channel][bin]`.
    MatchedFilter,
    /// Band spectra of the channels to band spectra of the directions, complex `[direction][bin]`.
    DelayAndSum,
    /// Band spectra of the directions to the energyscape, `[direction][range]`.
    Envelope,
    /// Band spectra of the channels to the near ranges of the energyscape, focused on their exact path, `[direction][range]`.
    Focus,
    /// Energyscapes to the sums of the mask table's rows.
    MaskedEnergy,
}

/// Time of each stage, nanoseconds, in the order of [`Stage::ALL`].
pub type StageTimes = [u64; Stage::ALL.len()];

impl Stage {
    /// All stages in order.
    pub const ALL: [Stage; 6] = [
        Stage::Demodulate,
        Stage::MatchedFilter,
        Stage::DelayAndSum,
        Stage::Envelope,
        Stage::Focus,
        Stage::MaskedEnergy,
    ];

    /// The stem shared by shader, CPU twin, oracle, bench and timing label.
    #[must_use]
    pub fn stem(self) -> &'static str {
        match self {
            Stage::Demodulate => "demodulate",
            Stage::MatchedFilter => "matched_filter",
            Stage::DelayAndSum => "delay_and_sum",
            Stage::Envelope => "envelope",
            Stage::Focus => "focus",
            Stage::MaskedEnergy => "masked_energy",
        }
    }
}

/// Everything made from one ping set. Made once at open, filled again for every set.
#[derive(Debug, Clone)]
pub struct Image {
    /// Sequence of the ping set.
    pub sequence: u64,
    /// Oldest emission time of the pings imaged.
    pub emitted_at: Stamp,
    /// Which sensors were imaged; the images and sums of others are those of silence and mean nothing.
    pub imaged: [bool; SENSORS_MAX],
    /// One energyscape a configured sensor.
    pub energyscapes: Vec<Energyscape>,
    /// One entry a row of the mask table.
    pub sums: Vec<RowSums>,
    /// What was found wrong with each sensor's channels.
    pub channels: Vec<ChannelReport>,
    /// Which backend made it.
    pub backend: BackendKind,
}

impl Image {
    /// Zero images for the sensors of `plan` and silent sums for the rows of `masks`.
    #[must_use]
    pub fn empty(plan: &ImagingPlan, masks: &MaskTable) -> Self {
        Self {
            sequence: 0,
            emitted_at: Stamp::default(),
            imaged: [false; SENSORS_MAX],
            energyscapes: (0..plan.sensors.len())
                .map(|index| Energyscape::zeros(Arc::clone(&plan.grid), index))
                .collect(),
            sums: vec![RowSums::SILENT; masks.rows.len()],
            channels: plan.sensors.iter().map(|sensor| ChannelReport::new(sensor.channel_count)).collect(),
            backend: BackendKind::Cpu,
        }
    }

    /// Says of which ping set this is the image, and who made it; all sensors present were imaged.
    pub(super) fn stamp(&mut self, pings: &PingSet, backend: BackendKind) {
        self.imaged = pings.present;
        self.backend = backend;
        self.sequence = pings.sequence;
        self.emitted_at = pings.emitted_at;
    }
}

/// The two twins. The numbers are on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum BackendKind {
    /// [`super::cpu`].
    Cpu = 0,
    /// `super::gpu`.
    Gpu = 1,
}

impl BackendKind {
    /// `cpu` or `gpu`.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            BackendKind::Cpu => "cpu",
            BackendKind::Gpu => "gpu",
        }
    }
}

/// What a backend says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BackendReport {
    /// Which twin.
    pub kind: BackendKind,
    /// Adapter name and driver, or the instruction set for the CPU.
    pub adapter: String,
    /// Why this backend was chosen, in one sentence.
    pub reason: String,
    /// Threads it computes on (CPU), or 1.
    pub threads: usize,
}

/// Output of a named stage, for tests and fault finding.
#[derive(Debug, Clone, PartialEq)]
pub enum StageOutput {
    /// Real values, row-major: `[channel][sample]` or `[direction][range]`.
    Real(Vec<f32>),
    /// Complex values, row-major: `[channel][bin]` or `[direction][bin]`.
    Complex(Vec<[f32; 2]>),
    /// Sums, one a row of the mask table.
    Sums(Vec<RowSums>),
}

/// Why a backend could not image a ping set.
#[derive(Debug, Clone, thiserror::Error)]
pub enum BackendError {
    /// The ping does not fit the plan.
    #[error("sensor {sensor_index}: found {found}, the configuration says {allowed}")]
    PingShape {
        /// Index of the sensor.
        sensor_index: usize,
        /// What was delivered.
        found: String,
        /// What was expected.
        allowed: String,
    },
    /// No adapter fits, or it lacks a limit.
    #[error("no GPU to use: {0}")]
    Unavailable(String),
    /// The device was lost.
    #[error("GPU lost: {0}")]
    Lost(String),
    /// The device did not finish in time.
    #[error("GPU did not finish within {limit_ms} ms")]
    Timeout {
        /// The limit.
        limit_ms: u64,
    },
    /// The CPU backend cannot work, or one of its threads failed.
    #[error("CPU backend: {0}")]
    Cpu(String),
    /// A result that cannot be one: wrong nonce, poison left, not finite.
    #[error("GPU returned no valid result: {0}")]
    Invalid(String),
}

/// One of the twins.
pub trait Backend: Send {
    /// Images every ping that is present. `image` was made by [`Image::empty`] for the same plan and masks; a sensor
    /// that is absent gets `imaged == false`. Fills `energyscapes`, `sums`, `imaged`, `backend`, `sequence` and
    /// `emitted_at`; `image.channels` is read: its gains weight the channels (see [`ChannelReport::gains`]).
    ///
    /// Allocates nothing after the first call on the CPU.
    ///
    /// # Errors
    /// [`BackendError`]; `image` is then to be thrown away.
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError>;

    /// Output of `stage` for one sensor of the ping set. Slow: for tests and for finding faults.
    ///
    /// # Errors
    /// As [`Backend::image`].
    fn image_up_to(
        &mut self,
        stage: Stage,
        pings: &PingSet,
        sensor_index: usize,
        image: &mut Image,
    ) -> Result<StageOutput, BackendError>;

    /// Time of each stage in the last call of [`Backend::image`], nanoseconds, in the order of [`Stage::ALL`]; zeros
    /// where it is not known.
    fn stage_times_ns(&self) -> StageTimes;

    /// What this backend is.
    fn report(&self) -> &BackendReport;
}
