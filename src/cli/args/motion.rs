//! `noctule detect motion` as it may be typed.

use super::SeriesArguments;
use clap::{ArgAction, Args};
use std::path::PathBuf;

/// Most drives of one call.
const RUNS_MAX: u64 = 100_000;

/// `detect motion`.
#[derive(Debug, Args)]
#[command(after_help = "Drives go round the worlds and layouts; in every second one the wheels slip
three times. What the echoes alone say is held against the truth of the
simulator; odometry with wheels 0.5 % wrong stands beside it.

Table: V_% and w_%, ping sets in which speed and turn rate were observed;
V_m/s and w_rad/s, root mean square errors there, after the slash those of
odometry; nees, mean squared error over the covariance, 2 if that is honest;
slips, told of those there, mean delay, and false alarms an hour; movers,
told at some time of those there; time, share of the ping sets in which they
were; v_err, error of their velocity; contact, of the time to contact;
ghosts an hour; hits, contacts of the robot with anything, and least gap to
a mover.

Examples:
  noctule detect motion --runs 4
  noctule detect motion fixtures/worlds/*.toml --runs 100 --json table.json
  noctule detect motion fixtures/worlds/crossing.toml --give-room --no-slip
  noctule detect motion --runs 2 --plot drive.png")]
pub struct MotionArguments {
    /// World files, or `office` for the built-in world, which it is without any.
    #[arg(value_name = "WORLD")]
    pub worlds: Vec<PathBuf>,
    /// Configuration file.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
    /// Layouts of paper 000, sim-1 to sim-10 and real-1 to real-6, one after the other; five of them without it.
    #[arg(short, long, value_name = "N", conflicts_with = "config", value_delimiter = ',', action = ArgAction::Append)]
    pub layout: Vec<String>,
    /// Number of drives, with seeds from --seed upward.
    #[arg(short, long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=RUNS_MAX))]
    pub runs: u64,
    /// Longest drive, in simulated seconds.
    #[arg(long, value_name = "S", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub duration: u32,
    /// No wheel slips.
    #[arg(long)]
    pub no_slip: bool,
    /// Have the controller give movers room, whatever [control.movers] says.
    #[arg(long)]
    pub give_room: bool,
    /// Seeds, threads, JSON.
    #[command(flatten)]
    pub series: SeriesArguments,
    /// Draw the second drive, in which the wheels slip (the first with --no-slip): velocities over time, movers on the map.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
}
