//! `noctule detect space` as it may be typed.

use clap::{ArgAction, Args};
use std::path::PathBuf;

/// Most rooms of one call.
const RUNS_MAX: u64 = 100_000;

/// `detect space`.
#[derive(Debug, Args)]
#[command(after_help = "Every room has a floor 0.40 m below the sensor, a ceiling 1.90 m above it, and
at random places balls and bars: on the floor, at the robot's height (-0.32 to
0.30 m) and overhead. The first line is the level fan of the configuration: all
that it hears is in its way.

Table: floor, obstacle, overhang, ceiling, found and there; right, share of the
found that were told as what they are; false, points called obstacles that are
none, a room; ghosts, points that are no thing, a room; r_m, az, el, root mean
square errors of range (m) and of the angles (degrees); nees, mean squared error
over the covariance, 3 if that is honest; image and find, milliseconds on one
thread of the CPU.

Examples:
  noctule detect space --runs 5
  noctule detect space --runs 100 --directions 500,1000,2000,4000 --json table.json
  noctule detect space --runs 1 --directions 2000 --plot space.png")]
pub struct SpaceArguments {
    /// Configuration file; its first sensor looks.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
    /// Equal-area grids, by their number of directions.
    #[arg(short, long, value_name = "N", value_delimiter = ',', action = ArgAction::Append, default_values_t = [500, 1000, 2000, 4000])]
    pub directions: Vec<usize>,
    /// Number of rooms, with seeds from --seed upward.
    #[arg(short, long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=RUNS_MAX))]
    pub runs: u64,
    /// First seed: it decides the room and its noise.
    #[arg(short, long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Write the table as JSON.
    #[arg(long, value_name = "F")]
    pub json: Option<PathBuf>,
    /// Draw the first room from above and from the side: what the fan takes it for, and what the last grid does.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
}
