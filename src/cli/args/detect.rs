//! `noctule detect` as it may be typed.

use super::{ConfigChoice, MotionArguments, ScenesArguments, SeriesArguments, SpaceArguments};
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Most corridors of one call.
const RUNS_MAX: u64 = 100_000;

/// `detect`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  echo '{\"ranges_m\": [null, null, null, 0.3563, 0.4199, null, null, null],
    \"pose\": {\"x_m\": 1.3, \"y_m\": 3.0, \"heading_deg\": 0}, \"edge\": [[1, 3], [3, 3]]}' | noctule detect projection
  noctule detect edges office --plot edges.png
  noctule detect corridors --runs 5 --plot ways.png
  noctule detect scenes --runs 5 --plot grid.png
  noctule detect motion --runs 4 --plot drive.png")]
pub struct DetectArguments {
    /// For all of them; each takes it after its name, too.
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// What is to be done.
    #[command(subcommand)]
    pub action: DetectAction,
}

/// What `detect` can do.
#[derive(Debug, Subcommand)]
pub enum DetectAction {
    /// Vector projection on a planned edge (paper 001): JSON on standard input to JSON on standard output.
    #[command(
        after_help = "Reads JSON from standard input, one object; metres and degrees, null in ranges_m for no echo.

Examples:
  echo '{\"ranges_m\": [null, null, null, 0.3563, 0.4199, null, null, null],
    \"pose\": {\"x_m\": 1.3, \"y_m\": 3.0, \"heading_deg\": 0}, \"edge\": [[1, 3], [3, 3]]}' | noctule detect projection"
    )]
    Projection(DetectorArguments),
    /// Objects between neighbours of the virtual sonar ring (paper 003): JSON on standard input to JSON on standard output.
    #[command(
        after_help = "Reads JSON from standard input, one object; metres and degrees, null in ranges_m for no echo.

Examples:
  echo '{\"ranges_m\": [1, 1, null, null, null, null, null, null, null, null, null, null],
    \"pose\": {\"x_m\": 0, \"y_m\": 0, \"heading_deg\": 0}}' | noctule detect ring"
    )]
    Ring(DetectorArguments),
    /// Edges to drive on: the midlines between the walls of a world (generalized Voronoi diagram).
    Edges(EdgesArguments),
    /// Drive a simulated robot through random corridors with obstacles, vector projection against the classical detector.
    Corridors(CorridorsArguments),
    /// Find round things on random maps with the virtual sonar ring, in one ping, over a second, and the way of paper 003.
    Scenes(ScenesArguments),
    /// Drive simulated robots and tell their motion by echoes alone, slips of the wheels and movers, against the truth.
    Motion(MotionArguments),
    /// Tell floor, ceiling, obstacles and what hangs over in simulated rooms, on equal-area grids, against the truth.
    Space(SpaceArguments),
}

/// `detect projection`, `detect ring`.
#[derive(Debug, Args)]
pub struct DetectorArguments {
    /// Parameters: `[detect.projection]` and `[detect.ring]` of the configuration.
    #[command(flatten)]
    pub choice: ConfigChoice,
}

/// `detect edges`.
#[derive(Debug, Args)]
#[command(after_help = "What is narrower than safe_width_m of [detect.projection] is left out, as is
what cannot be reached from the world's start zone.

Examples:
  noctule detect edges fixtures/worlds/t_junction.toml
  noctule detect edges office --json --plot edges.png")]
pub struct EdgesArguments {
    /// World file, or `office` for the built-in world.
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print JSON: nodes and midlines with all their points.
    #[arg(long)]
    pub json: bool,
    /// Draw the edges in their world.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
}

/// `detect corridors`.
#[derive(Debug, Args)]
#[command(after_help = "Every detector drives the same corridors, 1.2 m wide, with bends and 0 to 3
obstacles; the robot obeys the follower of the path alone.

Table: detected, of the obstacles on the safe path that the robot came to;
false, stops at anything else (of these at walls); arrived, at the end of
the path; blocked, rightly where there is no room, and wrongly; clear_m,
smallest and median gap between robot and anything.

Examples:
  noctule detect corridors --runs 5
  noctule detect corridors --runs 50 --json table.json --plot ways.png
  noctule detect corridors --world fixtures/worlds/coverage.toml --plot 9.png")]
pub struct CorridorsArguments {
    /// Configuration file; the built-in P3-DX with two sonars without it.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
    /// Drive from the start of this world over its waypoints instead of random corridors.
    #[arg(long, value_name = "WORLD", conflicts_with = "runs")]
    pub world: Option<PathBuf>,
    /// Number of corridors, with seeds from --seed upward.
    #[arg(short, long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=RUNS_MAX))]
    pub runs: u64,
    /// Seeds, threads, JSON.
    #[command(flatten)]
    pub series: SeriesArguments,
    /// Draw the ways of the first corridors, a row for each detector.
    #[arg(long, value_name = "F.png")]
    pub plot: Option<PathBuf>,
}
