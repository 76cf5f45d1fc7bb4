//! Options of the detectors' commands that make many runs.

use clap::Args;
use std::path::PathBuf;

/// Which runs, how many at a time, and where the numbers go.
#[derive(Debug, Args)]
pub struct SeriesArguments {
    /// First seed: it decides all that is drawn by chance; the next runs have the next seeds.
    #[arg(short, long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Runs at the same time; as many as there are cores without it.
    #[arg(short, long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Write table and runs as JSON.
    #[arg(long, value_name = "F")]
    pub json: Option<PathBuf>,
}
