//! `noctule detect scenes` as it may be typed.

use super::SeriesArguments;
use clap::Args;
use std::path::PathBuf;

/// Most scenes of one call.
const RUNS_MAX: u64 = 100_000;

/// `detect scenes`.
#[derive(Debug, Args)]
#[command(after_help = "Every method looks at the same scenes: three to six round things of 3 to 5 cm
radius, 0.3 to 1.4 m from the robot, on a map of 2 m by 2 m.

Table: hits, of the things there; ghosts, where nothing is; doubles, things
told twice; cells, whose cell of 20 cm the grid takes for occupied; median
and p95, of the errors in cm; nees, mean squared error over the covariance
told with it, 2 if that is honest; 1s 2s 3s, shares within so many
deviations, 39, 86 and 99 % if it is.

Examples:
  noctule detect scenes --runs 5
  noctule detect scenes --runs 100 --json table.json
  noctule detect scenes --runs 1 --plot grid.png   # the paper's experiment")]
pub struct ScenesArguments {
    /// Configuration file, three sensors 120 degrees apart; the built-in robot of the paper without it.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
    /// Number of scenes, with seeds from --seed upward.
    #[arg(short, long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=RUNS_MAX))]
    pub runs: u64,
    /// Seeds, threads, JSON.
    #[command(flatten)]
    pub series: SeriesArguments,
    /// Draw the paper's experiment: the grid after one second, objects, truth, and a way by A*.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
}
