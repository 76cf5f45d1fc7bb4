//! What was typed, what it means, and the exit code it ends with.
//!
//! Results go to standard output, talk to standard error. One file a command; each gives `Result<(), Failure>` and the
//! exit code is made here only (specification, section 11; codes as in `sysexits.h`).

mod args;
mod bench;
mod calibrate;
mod check;
mod config;
mod demo;
mod detect;
mod doctor;
mod documents;
mod import;
mod masks;
mod output;
mod plot;
mod process;
mod record;
mod relay;
mod run;
mod series;
mod simulate;
mod soak;
mod status;
mod topics;
#[cfg(feature = "view")]
mod view;

pub use args::{Arguments, Command};

use crate::life::{self, LogQueue};
use std::fmt;
use std::io::IsTerminal as _;
use std::process::ExitCode;
use std::sync::OnceLock;
use std::time::Duration;

/// Exit codes of the specification.
pub mod exit {
    /// A finding of `check`, `doctor`, `status` or `soak`.
    pub const FINDING: u8 = 1;
    /// Usage.
    pub const USAGE: u8 = 2;
    /// Bad data: a recording or world that cannot be used.
    pub const DATA: u8 = 65;
    /// Peer, GPU or service unavailable.
    pub const UNAVAILABLE: u8 = 69;
    /// Internal error.
    pub const INTERNAL: u8 = 70;
    /// Cannot create: no room, no folder.
    pub const CANNOT_CREATE: u8 = 73;
    /// Input or output error.
    pub const IO: u8 = 74;
    /// IPC state is stuck; the supervisor wipes it.
    pub const IPC_STUCK: u8 = 75;
    /// No permission.
    pub const PERMISSION: u8 = 77;
    /// Configuration.
    pub const CONFIG: u8 = 78;
}

/// A command that did not succeed: what to tell the user and how to exit.
#[derive(Debug)]
pub struct Failure {
    /// Exit code.
    pub code: u8,
    /// The message, without a final newline; empty when everything was said already.
    pub message: String,
}

impl Failure {
    /// A failure with a code of [`exit`].
    pub fn new(code: u8, message: impl fmt::Display) -> Self {
        Self { code, message: message.to_string() }
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        let code = match error.kind() {
            std::io::ErrorKind::PermissionDenied => exit::PERMISSION,
            _ => exit::IO,
        };
        Self::new(code, error)
    }
}

/// Runs the command line and gives the process's exit code.
#[must_use]
pub fn main() -> ExitCode {
    let arguments = match <Arguments as clap::Parser>::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are results and exit with 0; a broken pipe while printing them is no failure either.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { exit::USAGE } else { 0 });
        }
    };
    start_logging(arguments.verbose, arguments.quiet);
    let code = match dispatch(arguments.command) {
        Ok(()) => 0,
        Err(failure) => {
            if !failure.message.is_empty() {
                say(&format!("noctule: {}\n", failure.message));
            }
            failure.code
        }
    };
    if let Some(log) = LOG.get() {
        log.finish(LOG_FINISH_LIMIT);
    }
    if life::panic::is_dying() || code == exit::INTERNAL {
        // A thread that panicked or hangs must not be waited for by whatever a driver does at the end of a process.
        signal_hook::low_level::exit(i32::from(exit::INTERNAL));
    }
    if crate::imaging::driver_at_work() {
        // Nor must a library be taken apart under a driver that still works in it: that ends with an abort.
        let _ = std::io::Write::flush(&mut std::io::stdout());
        signal_hook::low_level::exit(i32::from(code));
    }
    ExitCode::from(code)
}

/// To standard error, by way of the log: it may be a pipe that nobody reads.
fn say(line: &str) {
    match LOG.get() {
        Some(log) => drop(std::io::Write::write_all(&mut log.clone(), line.as_bytes())),
        None => eprint!("{line}"),
    }
}

/// The log, to be written to its end before the program ends.
static LOG: OnceLock<LogQueue> = OnceLock::new();
/// Longest wait for a log that nobody reads.
const LOG_FINISH_LIMIT: Duration = Duration::from_millis(100);

/// Log level comes from the command line alone: no environment variable changes what the program does.
pub fn start_logging(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => log::LevelFilter::Error,
        (false, 0) => log::LevelFilter::Info,
        (false, 1) => log::LevelFilter::Debug,
        (false, _) => log::LevelFilter::Trace,
    };
    let foreign = if verbose > 2 { level } else { log::LevelFilter::Warn.min(level) };
    let mut builder = env_logger::Builder::new();
    builder.filter_level(foreign).filter_module("noctule", level).format_target(false);
    // Without a thread the log is written where it arises.
    if let Ok(queue) = LogQueue::start(std::io::stderr()) {
        let coloured = std::io::stderr().is_terminal();
        builder.write_style(if coloured { env_logger::WriteStyle::Always } else { env_logger::WriteStyle::Never });
        builder.target(env_logger::Target::Pipe(Box::new(LOG.get_or_init(|| queue).clone())));
    }
    builder.init();
}

fn dispatch(command: Command) -> Result<(), Failure> {
    match command {
        Command::Demo(arguments) => demo::demo(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Controller(arguments) => run::controller(&arguments),
        Command::Arm(arguments) => run::operator(&arguments, run::Request::Arm),
        Command::Stop(arguments) => run::operator(&arguments, run::Request::Stop),
        Command::Reset(arguments) => run::operator(&arguments, run::Request::Reset),
        Command::Wipe(arguments) => run::wipe(&arguments),
        Command::Record(arguments) => record::record(&arguments),
        Command::Replay(arguments) => record::replay(&arguments),
        Command::Process(arguments) => process::process(&arguments),
        Command::Calibrate(arguments) => calibrate::calibrate(&arguments),
        Command::Simulate(arguments) => simulate::simulate(&arguments),
        Command::Soak(arguments) => soak::soak_command(&arguments),
        Command::Masks(arguments) => masks::masks(&arguments),
        Command::Bench(arguments) => bench::bench(&arguments),
        Command::Detect(arguments) => detect::detect(&arguments),
        Command::Relay(arguments) => relay::relay(&arguments),
        Command::Topics(arguments) => topics::topics(&arguments),
        Command::Echo(arguments) => topics::echo(&arguments),
        #[cfg(feature = "view")]
        Command::View(arguments) => view::view(&arguments),
        Command::Check(arguments) => check::check(&arguments),
        Command::Status(arguments) => status::status(&arguments),
        Command::Doctor(arguments) => doctor::doctor(&arguments),
        Command::Plot(arguments) => plot::plot(&arguments),
        Command::Completions(arguments) => documents::completions(&arguments),
        Command::Man(arguments) => documents::man(&arguments),
        Command::Config(arguments) => config::config(&arguments),
    }
}
