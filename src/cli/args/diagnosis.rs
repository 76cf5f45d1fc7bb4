//! Commands that look, explain and document, as they may be typed.

use super::{ConfigChoice, seconds};
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// `topics`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule topics                                 every topic, type and field
  noctule topics --config robot.toml --json      for programs: root, prefix, byte offsets, schema hashes
  noctule topics --json --relayed                what a client on another machine needs
  noctule topics --c-header                      the types for C and C++
  noctule topics --transport                     for the transport's own tools: config/iceoryx2.toml")]
pub struct TopicsArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print one JSON object instead of the tables.
    #[arg(long)]
    pub json: bool,
    /// Print the types as a C header.
    #[arg(long, conflicts_with_all = ["json", "relayed", "transport"])]
    pub c_header: bool,
    /// With --json: the copies that `noctule relay` makes, as a client on another machine needs them.
    #[arg(long, requires = "json")]
    pub relayed: bool,
    /// Print the transport's own configuration (iceoryx2.toml), for its command line tools and its link.
    #[arg(long, conflicts_with = "json")]
    pub transport: bool,
}

/// `echo`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule echo noctule/command                   every sample as a line, until Ctrl-C
  noctule echo platform --json --count 10        noctule/ may be left out
  noctule echo noctule/sonar/front/energyscape --rate
  noctule echo noctule/health --config robot.toml --duration 5")]
pub struct EchoArguments {
    /// Topic, for example noctule/command; `noctule topics` lists them.
    pub topic: String,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
    /// Instead of samples tell once a second how many come, and how long ago what they tell of happened.
    #[arg(long)]
    pub rate: bool,
    /// End after this many samples; with --rate after this many seconds.
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// End after this many seconds.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
}

/// `check`.
#[derive(Debug, Args)]
#[command(
    after_help = "Exit 1 with a finding, 65 for a recording or world of no use, 78 for a configuration of no use.

Examples:
  noctule check robot.toml
  noctule check world.toml
  noctule check ping.bin --config robot.toml     format, channels that are unfit, emitter and array as heard
  noctule check corridor.wav --json"
)]
pub struct CheckArguments {
    /// Configuration or world (.toml), or recording (.npy, .npz, .wav, .bin).
    pub file: PathBuf,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `config`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_help = "Examples:
  noctule config --default > robot.toml          every key with its meaning, to start from
  noctule config --config robot.toml             what is in force, defaults filled in
  noctule config --reference                     every key with type, default, range and meaning
  noctule config import settings.json --out robot.toml")]
pub struct ConfigArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print the built-in defaults.
    #[arg(long, conflicts_with = "config")]
    pub default: bool,
    /// Print the reference of all keys as Markdown.
    #[arg(long, conflicts_with_all = ["config", "default"])]
    pub reference: bool,
    /// Something else than printing.
    #[command(subcommand)]
    pub action: Option<ConfigAction>,
}

/// What `config` does besides printing.
#[derive(Debug, Subcommand)]
pub enum ConfigAction {
    /// Turn the JSON settings of RTIS Dev (recording, processing, or both) into a configuration.
    Import(ImportArguments),
}

/// `config import`.
#[derive(Debug, Args)]
#[command(after_help = "Keys that have no counterpart stand as comments in the result.

Examples:
  noctule config import settings.json
  noctule config import recording.json processing.json --out robot.toml")]
pub struct ImportArguments {
    /// JSON files of settings; a later one adds to those before.
    #[arg(required = true, value_name = "SETTINGS.json")]
    pub settings: Vec<PathBuf>,
    /// File to write; standard output without it. An existing file is not overwritten.
    #[arg(short, long, value_name = "F.toml")]
    pub out: Option<PathBuf>,
}

/// `status`.
#[derive(Debug, Args)]
#[command(after_help = "Exit 0 when all is well, 1 with a finding, 69 where nobody runs.

Examples:
  noctule status
  noctule status --config robot.toml --watch     again and again, until Ctrl-C
  noctule status --json")]
pub struct StatusArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print one JSON object a look.
    #[arg(long)]
    pub json: bool,
    /// Look again and again, until Ctrl-C.
    #[arg(short, long)]
    pub watch: bool,
}

/// `doctor`.
#[derive(Debug, Args)]
#[command(
    after_help = "Makes and changes nothing; may run beside a live system. Exit 1 with a problem; notes are no problems.

Examples:
  noctule doctor
  noctule doctor --config robot.toml
  noctule doctor --json"
)]
pub struct DoctorArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `completions`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule completions bash > ~/.local/share/bash-completion/completions/noctule
  noctule completions zsh > ~/.zfunc/_noctule
  noctule completions fish > ~/.config/fish/completions/noctule.fish")]
pub struct CompletionsArguments {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
    /// For noctule-controller instead.
    #[arg(long)]
    pub controller: bool,
}

/// `man`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule man man1                               then: man ./man1/noctule-run.1")]
pub struct ManArguments {
    /// Folder to write to; made if missing.
    #[arg(value_name = "DIR")]
    pub out: PathBuf,
}
