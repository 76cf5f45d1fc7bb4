//! The command line of `noctule-controller`: what was typed, and the exit code. `noctule controller` means the same.

use crate::config::Config;
use crate::controller_process;
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;

const EXIT_USAGE: u8 = 2;
const EXIT_CONFIG: u8 = 78;

/// The thin controller: takes velocity commands, enforces the safe state, drives the platform.
#[derive(Debug, Parser)]
#[command(name = "noctule-controller", version)]
struct Arguments {
    /// Configuration; of it, platform, safety and ipc are used. Built-in defaults without it.
    #[arg(long, value_name = "F")]
    config: Option<PathBuf>,
    /// Arm once, for the first live daemon; never after a latch.
    #[arg(long)]
    arm: bool,
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
    // The level is fixed: no environment variable changes what the process does.
    env_logger::Builder::new().filter_level(log::LevelFilter::Info).format_target(false).init();
    let config = match &arguments.config {
        None => Config::default(),
        Some(path) => match Config::load(path) {
            Ok(config) => config,
            Err(error) => {
                log::error!("{error}");
                return ExitCode::from(EXIT_CONFIG);
            }
        },
    };
    ExitCode::from(controller_process::serve(&config, arguments.arm))
}
