//! The command line of `noctule-controller`: what was typed, and the exit code. `noctule controller` means the same.

use crate::config::Config;
use crate::controller_process;
use crate::life::LogQueue;
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

const EXIT_USAGE: u8 = 2;
const EXIT_CONFIG: u8 = 78;
/// Longest wait for a log that nobody reads.
const LOG_FINISH_LIMIT: Duration = Duration::from_millis(100);

/// The thin controller: takes velocity commands, enforces the safe state, drives the platform.
#[derive(Debug, Parser)]
#[command(name = "noctule-controller", version)]
#[command(after_help = "Examples:
  noctule-controller --config robot.toml         waits to be armed: `noctule arm`
  noctule-controller --config robot.toml --arm   arms once, for the first live daemon")]
struct Arguments {
    /// Configuration; of it, platform, safety and ipc are used. Built-in defaults without it.
    #[arg(long, value_name = "F")]
    config: Option<PathBuf>,
    /// Arm once, for the first live daemon; never after a latch.
    #[arg(long)]
    arm: bool,
}

/// The command line, for its manual page, its completions and tests.
#[must_use]
pub fn command() -> clap::Command {
    <Arguments as clap::CommandFactory>::command()
}

/// Runs the controller process as the command line says.
#[must_use]
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { EXIT_USAGE } else { 0 });
        }
    };
    let log = start_logging();
    let code = serve(&arguments);
    if let Some(log) = log {
        log.finish(LOG_FINISH_LIMIT);
    }
    ExitCode::from(code)
}

/// The level is fixed: no environment variable changes what the process does. A log that is blocked must not even hold up the start.
fn start_logging() -> Option<LogQueue> {
    let mut builder = env_logger::Builder::new();
    builder.filter_level(log::LevelFilter::Info).format_target(false);
    // Without a thread the log is written where it arises.
    let queue = LogQueue::start(std::io::stderr()).ok();
    if let Some(queue) = &queue {
        builder.write_style(env_logger::WriteStyle::Never);
        builder.target(env_logger::Target::Pipe(Box::new(queue.clone())));
    }
    builder.init();
    queue
}

fn serve(arguments: &Arguments) -> u8 {
    let config = match &arguments.config {
        None => Config::default(),
        Some(path) => match Config::load(path) {
            Ok(config) => config,
            Err(error) => {
                log::error!("{error}");
                return EXIT_CONFIG;
            }
        },
    };
    controller_process::serve(&config, arguments.arm)
}
