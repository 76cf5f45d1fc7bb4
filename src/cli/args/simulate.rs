//! `noctule simulate` as it may be typed (specification, section 11).
//!
//! What is typed wrong is refused here; what does not exist (a layout, a sensor) is refused by the command itself, which knows
//! the names there are.

use super::BackendArgument;
use clap::{ArgAction, Args};
use std::path::PathBuf;

/// Candidates drawn by `--sweep` without a number.
const SWEEP_DEFAULT: &str = "12";
/// Most runs, and most candidates, of one call.
const COUNT_MAX: u64 = 100_000;

/// `simulate`.
///
/// Drives simulated robots through a world, faster than real time: microphone signals, imaging, controller and gate are
/// the daemon's own. A run depends on world, layout and seed only, never on the number of jobs. A contact is a result, not
/// an error.
#[derive(Debug, Args)]
#[command(after_help = "Sweep: draws candidate sensor layouts for the robot of --config or the
first --layout and ranks them together with the layouts given: fewest
contacts first, then fewest goals missed, then fewest near-misses
(clearance fell below 0.1 m), then the shortest mean time to the goal, then the largest clearance.

Table: goals, waypoints reached of all; clear_m, least clearance; stop_s,
longest stop while motion was wanted; alone_s, the same with no mover within
1 m; turns/m, changes of the turn's sign while following walls; layers, the
share of the ping sets that each decided.

Exit codes: 0 whatever the robots did; 2 usage; 65 a world of no use or a
run that could not begin; 69 no such backend; 78 a configuration of no use.

Examples:
  noctule simulate office --runs 15
  noctule simulate world.toml --layout sim --json runs.json --plot heat.png
  noctule simulate office --layout 4 --trajectories tracks --paths paths.png
  noctule simulate office --noise-db 10 --lose left@20 --multipath
  noctule simulate office --sweep 20 --runs 5 --json r.json --plot r.png
  noctule simulate office --layout sim --sweep 0 --runs 5   # draws none")]
pub struct SimulateArguments {
    /// World file, or `office` for the built-in world.
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Configuration file; the built-in three-sensor robot without it.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
    /// Layout of paper 000: sim-1 to sim-10 (a number N means sim-N), real-1 to real-6, default for the built-in robot, or a
    /// group: sim, real, all. May be given several times or as a list with commas.
    #[arg(short, long, value_name = "N", conflicts_with = "config", value_delimiter = ',', action = ArgAction::Append)]
    pub layout: Vec<String>,
    /// Runs of each layout, with seeds from --seed upward.
    #[arg(short, long, value_name = "R", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=COUNT_MAX))]
    pub runs: u64,
    /// First seed: it decides start, noise and odometry.
    #[arg(short, long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Backend; the configuration's without it.
    #[arg(long, value_enum, value_name = "B")]
    pub backend: Option<BackendArgument>,
    /// Runs at the same time; as many as there are cores without it, one with a GPU.
    #[arg(short, long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Write the results as JSON; `-` for standard output, instead of the table.
    #[arg(long, value_name = "F")]
    pub json: Option<PathBuf>,
    /// Write a CSV file of each run, LAYOUT_SEED.csv, into this folder; made if missing.
    #[arg(long, value_name = "DIR")]
    pub trajectories: Option<PathBuf>,
    /// Draw the heat map of all drives over the world; with --sweep the best candidates instead.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
    /// Draw the way of each run, coloured by the layer that decided; a panel for each layout.
    #[arg(long, value_name = "F.png", conflicts_with = "sweep")]
    pub paths: Option<PathBuf>,
    /// Draw what the first robot's sensors heard on its first drive: their polar images every ten seconds, a row each.
    #[arg(long, value_name = "F.png", conflicts_with = "sweep")]
    pub frames: Option<PathBuf>,
    /// Rank sensor layouts, drawing this many candidates beside those given.
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = SWEEP_DEFAULT, value_parser = clap::value_parser!(u64).range(0..=COUNT_MAX))]
    pub sweep: Option<u64>,
    #[command(flatten)]
    pub conditions: ConditionArguments,
}

/// What makes a run harder.
#[derive(Debug, Args)]
#[command(next_help_heading = "Harder runs")]
pub struct ConditionArguments {
    /// Raise the noise floor by this many decibels.
    #[arg(long, value_name = "DB", default_value_t = 0.0, allow_negative_numbers = true, value_parser = decibels)]
    pub noise_db: f64,
    /// A sensor is lost from that second on; may be given several times.
    #[arg(long, value_name = "SENSOR@S", conflicts_with = "sweep", value_parser = loss)]
    pub lose: Vec<(String, f64)>,
    /// Make echoes over two walls as well.
    #[arg(long)]
    pub multipath: bool,
}

/// Accepts a change of level that leaves numbers meaningful.
fn decibels(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("found {text}, allowed: a number of decibels"))?;
    if (-120.0..=60.0).contains(&value) {
        Ok(value)
    } else {
        Err(format!("found {text}, allowed: a number from -120 to 60"))
    }
}

/// Reads `SENSOR@S`.
fn loss(text: &str) -> Result<(String, f64), String> {
    let refuse = || format!("found {text}, allowed: SENSOR@S, a sensor's name and the second from which it is lost");
    let (name, at) = text.rsplit_once('@').filter(|(name, _)| !name.is_empty()).ok_or_else(refuse)?;
    let at_s: f64 = at.parse().map_err(|_| refuse())?;
    if at_s >= 0.0 && at_s.is_finite() { Ok((name.to_owned(), at_s)) } else { Err(refuse()) }
}
