//! Recording a run to MCAP and reading it back.
//!
//! The deciding thread copies what it has into prepared [`slots`] once its command is out; a [`writer`] thread of lower priority
//! makes ROS messages of it ([`scribe`]) and puts them into a [`volume`] of files, which keeps the disk's reserve and budget.
//! No slot free: the ping set is not recorded, and counted. [`reader`] gives a recording back, up to the last whole chunk of a
//! file that was cut off. Nothing here is ever waited for by whoever decides.

#[cfg(feature = "mcap")]
mod file;
#[cfg(not(feature = "mcap"))]
#[path = "no_file.rs"]
mod file;
#[cfg(feature = "mcap")]
mod messages;
#[cfg(not(feature = "mcap"))]
#[path = "no_messages.rs"]
mod messages;
pub mod pings;
pub mod reader;
mod scribe;
pub mod slots;
pub mod topics;
mod volume;
mod writer;

pub use reader::{Entry, RunReader};
pub use slots::{Note, NoteTap, Slot, Tap};
pub use writer::{RecordState, Recorder, Recording, Tally};

use crate::sensor::{RecordingFormat, SensorSetup};
use crate::signal::{Energyscape, PingSet, PolarGrid, RangeScan};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// What a recording is allowed.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordOptions {
    /// The first file; parts get `_001`, `_002` before the ending. One that exists is never touched: `-2`, `-3` is tried.
    pub path: PathBuf,
    /// A new part after so many bytes.
    pub split_bytes: Option<u64>,
    /// A new part after this time.
    pub split_after: Option<Duration>,
    /// All parts together; beyond it the oldest parts of this recording are removed.
    pub budget_bytes: Option<u64>,
    /// Space that is left free on the disk: where less is free, recording ends.
    pub reserve_bytes: u64,
    /// Whether raw pings are recorded, which a replay needs.
    pub raw: bool,
    /// Ping sets that may wait for the disk.
    pub slot_count: usize,
    /// Whether whoever records waits for a free slot. For simulated time only.
    pub patient: bool,
}

impl RecordOptions {
    /// Space left free unless told otherwise: a minute of raw pings and enough for the system to live.
    pub const RESERVE_BYTES: u64 = 512 << 20;
    /// A second and a half at 10 Hz.
    pub const SLOT_COUNT: usize = 16;

    /// One file without a limit but the disk's reserve.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            split_bytes: None,
            split_after: None,
            budget_bytes: None,
            reserve_bytes: Self::RESERVE_BYTES,
            raw: true,
            slot_count: Self::SLOT_COUNT,
            patient: false,
        }
    }
}

/// Makes a range scan of an energyscape.
pub type ScanMaker = Box<dyn FnMut(&Energyscape, &mut RangeScan) + Send>;

/// What is recorded, besides what passes.
pub struct RecordSubject {
    /// The sensors, in the order of the configuration.
    pub sensors: Vec<SensorSetup>,
    /// Their grid.
    pub grid: Arc<PolarGrid>,
    /// Format of the raw data.
    pub format: RecordingFormat,
    /// Empty buffers as the pings need them.
    pub pings: PingSet,
    /// From one ping set to the next.
    pub period_s: f64,
    /// The configuration in force, as TOML: the file's attachment.
    pub config_toml: String,
    /// One a sensor.
    pub scanners: Vec<ScanMaker>,
}

/// One message of a file.
struct RawMessage<'a> {
    topic: &'a str,
    data: &'a [u8],
}

/// What was lost of a file that was cut off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Bytes up to the end of the last whole chunk.
    pub whole_bytes: u64,
    /// Bytes after it.
    pub lost_bytes: u64,
    /// Messages that were read.
    pub messages: u64,
}

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A file cannot be made.
    #[error("{}: cannot be made: {source}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The disk has too little room.
    #[error("{}: {free_mib} MiB free, {reserve_mib} MiB are kept free (--record-reserve-mib)", path.display())]
    Full {
        /// The file.
        path: PathBuf,
        /// Free space.
        free_mib: u64,
        /// Space to be left free.
        reserve_mib: u64,
    },
    /// Reading or writing failed.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why, with the system's words.
        reason: String,
    },
    /// The file holds something else, or is damaged.
    #[error("{}: found {found}, allowed: {allowed}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// This build cannot.
    #[error("this build of noctule has no MCAP: it was made without the feature mcap")]
    Unsupported,
    /// The system gives no thread.
    #[error("cannot start the recording thread: {0}")]
    Thread(std::io::Error),
}

impl RecordError {
    /// The state of a recording that this ended.
    #[must_use]
    pub fn state(&self) -> RecordState {
        if matches!(self, RecordError::Full { .. }) { RecordState::Full } else { RecordState::Failed }
    }

    /// Exit code of the specification.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            RecordError::Create { .. } | RecordError::Full { .. } => 73,
            RecordError::Io { .. } => 74,
            RecordError::Content { .. } => 65,
            RecordError::Unsupported => 69,
            RecordError::Thread(_) => 70,
        }
    }
}
