//! Arguments of `record` and `replay`, and those of every command that records on the side.

use super::{BackendArgument, ConfigChoice, seconds};
use crate::io::record::RecordOptions;
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// `--record` and what goes with it.
#[derive(Debug, Clone, Args)]
pub struct RecordingArguments {
    /// Record the run to this MCAP file, which is never overwritten: -2, -3 is added to its name.
    #[arg(long, value_name = "F.mcap")]
    pub record: Option<PathBuf>,
    #[command(flatten)]
    pub limits: RecordLimits,
}

/// What a recording is allowed.
#[derive(Debug, Clone, Args)]
pub struct RecordLimits {
    /// Begin a new file, F_001.mcap and so on, after so many MiB.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 30))]
    pub record_split_mib: Option<u64>,
    /// Begin a new file after this many seconds.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub record_split_s: Option<f64>,
    /// Keep no more than this of the recording: its oldest files are removed.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(16..=1 << 30))]
    pub record_budget_mib: Option<u64>,
    /// End the recording where less than this is free on the disk.
    #[arg(long, value_name = "MIB", default_value_t = RecordOptions::RESERVE_BYTES >> 20,
          value_parser = clap::value_parser!(u64).range(0..=1 << 30))]
    pub record_reserve_mib: u64,
    /// Leave out the raw pings: half the size or less, but nothing to replay.
    #[arg(long)]
    pub record_no_raw: bool,
}

impl RecordLimits {
    /// The options for a recording at `path`.
    #[must_use]
    pub fn options(&self, path: &Path) -> RecordOptions {
        RecordOptions {
            split_bytes: self.record_split_mib.map(|mib| mib << 20),
            split_after: self.record_split_s.map(Duration::from_secs_f64),
            budget_bytes: self.record_budget_mib.map(|mib| mib << 20),
            reserve_bytes: self.record_reserve_mib << 20,
            raw: !self.record_no_raw,
            ..RecordOptions::new(path)
        }
    }
}

impl RecordingArguments {
    /// The options, if anything is to be recorded.
    #[must_use]
    pub fn options(&self) -> Option<RecordOptions> {
        self.record.as_ref().map(|path| self.limits.options(path))
    }
}

/// `record`.
#[derive(Debug, Args)]
#[command(after_help = "\
Records what passes on the topics, from a process of its own. The file is read by Foxglove, by ROS 2 (ros2 bag) and by the Python
packages mcap-ros2-support and rosbags. To repeat a run to the bit, record it with noctule run --record.

Examples:
  noctule record day1.mcap --duration 60
  noctule record day1.mcap --record-split-mib 1024 --record-budget-mib 20480")]
pub struct RecordArguments {
    /// File to write; never overwritten: -2, -3 is added to its name.
    #[arg(value_name = "OUT.mcap")]
    pub out: PathBuf,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// End after this many seconds; at Ctrl-C without it.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
    #[command(flatten)]
    pub limits: RecordLimits,
}

/// `replay`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule replay day1.mcap --compare                        the same commands again? exit 1 if not
  noctule replay day1.mcap --config other.toml --compare    what another setting would have done")]
pub struct ReplayArguments {
    /// Recording of `noctule run --record`, its first part.
    #[arg(value_name = "F.mcap")]
    pub file: PathBuf,
    /// Configuration to run it with; the recorded one without it.
    #[arg(short, long, value_name = "G")]
    pub config: Option<PathBuf>,
    /// Backend; the CPU without it, whose results are the same to the bit.
    #[arg(long, value_enum, value_name = "B", default_value = "cpu")]
    pub backend: BackendArgument,
    /// Compare with what was recorded; exit 1 when anything differs.
    #[arg(long)]
    pub compare: bool,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}
