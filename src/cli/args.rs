//! The command line as it may be typed (specification, section 11).

mod calibrate;
mod detect;
mod diagnosis;
mod files;
mod motion;
mod record;
mod scenes;
mod series;
mod simulate;
mod space;
#[cfg(feature = "view")]
mod view;

pub use calibrate::CalibrateArguments;
pub use detect::{CorridorsArguments, DetectAction, DetectArguments, EdgesArguments};
pub use diagnosis::{
    CheckArguments, CompletionsArguments, ConfigAction, ConfigArguments, DoctorArguments, EchoArguments,
    ImportArguments, ManArguments, StatusArguments, TopicsArguments,
};
pub use files::{ExportFormat, PlotArguments, ProcessArguments};
pub use motion::MotionArguments;
pub use record::{RecordArguments, RecordingArguments, ReplayArguments};
pub use scenes::ScenesArguments;
pub use series::SeriesArguments;
pub use simulate::{ConditionArguments, SimulateArguments};
pub use space::SpaceArguments;
#[cfg(feature = "view")]
pub use view::{DEFAULT_LISTEN, ViewArguments};

use super::bench::Case;
use crate::imaging::params::Prefer;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Sonar processing for mobile robots: raw ultrasound in, energyscapes and safe velocity commands out.
#[derive(Debug, Parser)]
#[command(name = "noctule", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_help = "Examples:
  noctule demo                                   drive the simulated robot until Ctrl-C
  noctule run --config robot.toml --source live  the daemon on a robot
  noctule status --config robot.toml             does it run, and why does the robot stand?
  noctule doctor --config robot.toml             what prevents a start?
  noctule process a.npy --config robot.toml --out images --png
  noctule plot a.wav --config robot.toml         what did the microphones hear?
  noctule simulate office --layout all --runs 5  prove sensor layouts, faster than real time")]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Say more on standard error; twice for every ping.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Say only errors on standard error.
    #[arg(short, long, global = true)]
    pub quiet: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulator, daemon and controller process in one: no hardware, no GPU, no network needed.
    Demo(DemoArguments),
    /// The daemon: images pings, decides velocities, publishes both.
    Run(RunArguments),
    /// The thin controller process: gates commands and drives the platform. Also the binary noctule-controller.
    #[command(after_help = "Examples:
  noctule controller                             waits to be armed
  noctule controller --config robot.toml --arm   arms once, for the first live daemon
  noctule-controller --config robot.toml         the same as a program of its own")]
    Controller(ControllerArguments),
    /// Ask daemon and controller to arm: motion becomes possible.
    #[command(after_help = "Examples:
  noctule arm
  noctule arm --config robot.toml")]
    Arm(OperatorArguments),
    /// Ask daemon and controller to stop at once.
    #[command(after_help = "Examples:
  noctule stop
  noctule stop --config robot.toml")]
    Stop(OperatorArguments),
    /// Ask the daemon to leave its latched fault and test itself again.
    #[command(after_help = "Examples:
  noctule reset
  noctule reset --config robot.toml")]
    Reset(OperatorArguments),
    /// Remove what stopped processes left in shared memory; after exit code 75 this is the supervisor's.
    #[command(after_help = "Examples:
  noctule wipe                        when all processes have been stopped
  noctule wipe --config robot.toml")]
    Wipe(OperatorArguments),
    /// Record what passes on the topics to an MCAP file.
    Record(RecordArguments),
    /// Run a recording again, as fast as the machine can, and compare.
    Replay(ReplayArguments),
    /// Image recordings into NumPy files.
    Process(ProcessArguments),
    /// Measure the air, the emitter and the microphones from the direct path of recordings.
    Calibrate(CalibrateArguments),
    /// Drive simulated robots through a world and score them; rank sensor layouts.
    Simulate(SimulateArguments),
    /// Drive a simulated robot while something goes wrong every minute; score how it stops, stands and goes on.
    Soak(SoakArguments),
    /// Write the masks of the control regions, as arrays and pictures.
    Masks(MasksArguments),
    /// Time the stages and the whole ping, CPU and GPU side by side.
    Bench(BenchArguments),
    /// Detect obstacles or objects in range readings; midlines of a world; prove the detectors on simulated scenes.
    Detect(DetectArguments),
    /// List every topic with its types and the byte offset of every field.
    Topics(TopicsArguments),
    /// Copy energyscapes, commands and states to topics that the transport's link can carry to other machines.
    Relay(RelayArguments),
    /// Print what passes on a topic.
    Echo(EchoArguments),
    /// Serve the live page: energyscapes, regions, command and why, in a browser; metrics; Foxglove.
    #[cfg(feature = "view")]
    View(ViewArguments),
    /// Check a configuration, world or recording and say what is wrong with it.
    Check(CheckArguments),
    /// One look at a running system: who lives, whether the robot moves and why, what is not well.
    Status(StatusArguments),
    /// Look for what prevents a start or spoils a run; every line with its remedy.
    Doctor(DoctorArguments),
    /// Draw energyscapes, or what the microphones of a recording heard.
    Plot(PlotArguments),
    /// Print the configuration in force or the built-in one, explain every key, or import another program's settings.
    Config(ConfigArguments),
    /// Print a script that completes commands in a shell.
    Completions(CompletionsArguments),
    /// Write the manual pages.
    Man(ManArguments),
}

/// A backend as the command line names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BackendArgument {
    /// A hardware GPU if there is one, else the CPU.
    Auto,
    /// Any adapter, a software one included; exit 69 where there is none.
    Gpu,
    /// The CPU.
    Cpu,
}

impl From<BackendArgument> for Prefer {
    fn from(argument: BackendArgument) -> Self {
        match argument {
            BackendArgument::Auto => Prefer::Auto,
            BackendArgument::Gpu => Prefer::Gpu,
            BackendArgument::Cpu => Prefer::Cpu,
        }
    }
}

/// Where the configuration comes from.
#[derive(Debug, Clone, Args)]
pub struct ConfigChoice {
    /// Configuration file; the built-in three-sensor robot without it.
    #[arg(short, long, value_name = "F")]
    pub config: Option<PathBuf>,
}

/// `demo`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule demo --duration 20
  noctule demo --headless --duration 60 --json > summary.json
  noctule demo --world fixtures/worlds/corridor.toml")]
pub struct DemoArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// No status line and no live page: print the summary only.
    #[arg(long)]
    pub headless: bool,
    /// End after this many seconds from the first ping set; until Ctrl-C without it.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
    /// World file; the built-in office without it.
    #[arg(long, value_name = "W")]
    pub world: Option<PathBuf>,
    /// Backend; the configuration's without it.
    #[arg(long, value_enum, value_name = "B")]
    pub backend: Option<BackendArgument>,
    /// Seed of noise and start position.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Record the run to this MCAP file, which is never overwritten: -2, -3 is added to its name.
    #[arg(long, value_name = "F.mcap")]
    pub record: Option<PathBuf>,
    /// Print the summary as one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `run`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule run                                              simulated robot, default world
  noctule run --config robot.toml --source live            raw pings from drivers
  noctule run --config robot.toml --source replay:a.npy    a recording, at the pace it was made
  noctule run --record day1.mcap --record-budget-mib 8192  recorded; the newest 8 GiB are kept")]
pub struct RunArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// sim, sim:WORLD, replay:FILE or live.
    #[arg(long, default_value = "sim", value_name = "SOURCE")]
    pub source: String,
    /// Backend; the configuration's without it.
    #[arg(long, value_enum, value_name = "B")]
    pub backend: Option<BackendArgument>,
    /// End after this many seconds from the first ping set.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
    /// Seed of the simulator's noise and start position.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub record: RecordingArguments,
}

/// `controller`.
#[derive(Debug, Args)]
pub struct ControllerArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Arm once, for the first live daemon; never after a latch.
    #[arg(long)]
    pub arm: bool,
}

/// `arm`, `stop`, `reset`, `wipe`.
#[derive(Debug, Args)]
pub struct OperatorArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
}

/// `soak`.
#[derive(Debug, Args)]
#[command(
    after_help = "Prints one JSON object. Exit 1 when the robot moved when it must not, stopped too late, or stopped for nothing.

Examples:
  noctule soak                              six robot-minutes, a fault a minute
  noctule soak --minutes 60 --seed 7
  noctule soak --minutes 10 --fault-every 15"
)]
pub struct SoakArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Robot-minutes; simulated faster than real time.
    #[arg(long, value_name = "M", default_value_t = 6.0, value_parser = seconds)]
    pub minutes: f64,
    /// Seed of start, noise, faults and their order.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Seconds from one fault to the next, at most.
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = seconds)]
    pub fault_every: f64,
}

/// `masks`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule masks --config robot.toml --out masks
  noctule masks --layout sim-4 --out masks")]
pub struct MasksArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// One of the sensor layouts of paper 000 instead of a configuration.
    #[arg(long, value_name = "L", conflicts_with = "config",
          value_parser = clap::builder::PossibleValuesParser::new(crate::config::LAYOUT_NAMES))]
    pub layout: Option<String>,
    /// Folder to write to; made if missing.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `bench`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule bench                                  every stage, CPU and GPU side by side, beside the counted floor
  noctule bench --latency --busy                 last sample to command, idle and with all cores at work
  noctule bench --beamformers --plot sharp.png   what each beamformer makes of the same scenes, and what it costs
  noctule bench --emissions --plot plans.png     how well each emission plan keeps the sensors' sounds apart
  noctule bench --scaling --plot scaling.png     time and memory against microphones, directions, sensors, samples")]
pub struct BenchArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Only this backend; both without it.
    #[arg(long, value_enum, value_name = "B")]
    pub backend: Option<BackendArgument>,
    /// Only this number of sensors; one to all without it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=3))]
    pub sensors: Option<u32>,
    /// Ping sets measured for each row.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub iterations: u32,
    /// Print one JSON object instead of the table.
    #[arg(long)]
    pub json: bool,
    /// Predict the GPU's times for this card, beside what was measured; --backend gpu alone predicts for both.
    #[cfg(feature = "gpu")]
    #[arg(long, value_enum, value_name = "CARD", conflicts_with = "peak_gflops")]
    pub card: Option<super::bench::CardName>,
    /// Predict for a card of this peak of single-precision arithmetic, a multiply-add being two operations.
    #[cfg(feature = "gpu")]
    #[arg(long, value_name = "GFLOP/s", requires = "peak_gb_s", value_parser = positive)]
    pub peak_gflops: Option<f64>,
    /// Its peak of memory traffic.
    #[cfg(feature = "gpu")]
    #[arg(long, value_name = "GB/s", requires = "peak_gflops", value_parser = positive)]
    pub peak_gb_s: Option<f64>,
    /// Measure time and memory against microphones, directions, sensors and samples instead; CPU unless told otherwise.
    #[arg(long, conflicts_with_all = ["latency", "config"])]
    pub scaling: bool,
    /// Compare the beamformers on the same scenes instead: width of the main lobe, side lobes, weakest echo still seen, time.
    #[arg(long, conflicts_with_all = ["latency", "scaling"])]
    pub beamformers: bool,
    /// Compare plans of emission instead, on the CPU: how well each keeps the sensors' sounds apart, and what it costs.
    #[arg(long, conflicts_with_all = ["latency", "scaling", "beamformers"])]
    pub emissions: bool,
    /// Places of each room that --emissions listens at.
    #[arg(long, value_name = "N", default_value_t = 25, requires = "emissions",
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub places: u32,
    /// Draw what --scaling measured, or the images of --beamformers or --emissions.
    #[arg(long, value_name = "F.png", conflicts_with = "latency")]
    pub plot: Option<PathBuf>,
    /// Measure one configuration in this process; for the command's own use.
    #[arg(long, hide = true, requires_all = ["sensors", "backend"])]
    pub alone: bool,
    /// Measure one row of --scaling; for its own use.
    #[arg(long, hide = true)]
    pub scaling_row: Option<Case>,
    /// Measure last sample to command instead: daemon and controller process, fed by this one as a driver.
    #[arg(long)]
    pub latency: bool,
    /// Ping sets that --latency sends, 20 a second.
    #[arg(long, value_name = "N", default_value_t = 400, requires = "latency",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub sets: u32,
    /// Measure --latency a second time, with all cores kept at work.
    #[arg(long, requires = "latency")]
    pub busy: bool,
}

/// `relay`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule relay
  noctule relay --config robot.toml")]
pub struct RelayArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
}

/// Accepts a positive, finite number.
#[cfg(feature = "gpu")]
fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("found {text}, allowed: a number"))?;
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err(format!("found {text}, allowed: a number above 0")) }
}

/// Accepts a positive, finite number of seconds up to a year.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("found {text}, allowed: a number of seconds"))?;
    if value > 0.0 && value <= 31_557_600.0 {
        Ok(value)
    } else {
        Err(format!("found {text}, allowed: a number above 0, at most 31557600"))
    }
}
