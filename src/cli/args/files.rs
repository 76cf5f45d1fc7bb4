//! Commands on files of recordings and results, as they may be typed.

use super::{BackendArgument, ConfigChoice};
use crate::cli::process::Shard;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// How `process` writes its arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// energyscape.npy, directions_deg.npy, ranges_m.npy, meta.json.
    Npy,
    /// energyscape.npz with arrays energyscape, directions_deg, ranges_m and meta (JSON), beside meta.json.
    Npz,
}

/// `process`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  noctule process ping.bin --config robot.toml --out images --png
  noctule process corridor.wav --out images --format npz  # images/energyscape.npz, for numpy.load
  noctule process a.npy b.npy --config robot.toml --out images    # images/a, images/b
  noctule process day1 --out images                     # all recordings in day1; again after an interruption: the rest
  noctule process day1 --out images --shard 3/8         # the third of eight parts, in any order, on any machines
  parallel noctule process day1 --out images --jobs 1 --shard {}/8 ::: $(seq 8)")]
pub struct ProcessArguments {
    /// Recordings: .npy [pings, mics, samples] or [mics, samples] of i16 or f32, .npy u32 [pings, words], .npz with one such
    /// array, multichannel .wav, eRTIS .bin, or .mcap of noctule, which carries its own configuration; or folders of them.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Folder to write to; made if missing.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Backend; the configuration's without it.
    #[arg(long, value_enum, value_name = "B")]
    pub backend: Option<BackendArgument>,
    /// Sensor whose array and geometry the recordings have; the first without it.
    #[arg(long, value_name = "NAME")]
    pub sensor: Option<String>,
    /// Write a picture of every ping as well.
    #[arg(long)]
    pub png: bool,
    /// Files of arrays: one each, or all in one.
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = ExportFormat::Npy)]
    pub format: ExportFormat,
    /// Do only the I-th of N equal parts of the recordings, I from 1 to N; together the parts are everything.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
    /// Cores to use; all without it. The results are the same.
    #[arg(short, long, value_name = "J", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub jobs: Option<u32>,
    /// Do again what was finished before.
    #[arg(long)]
    pub force: bool,
}

/// `plot`.
#[derive(Debug, Args)]
#[command(
    after_help = "Of energyscapes (a folder of process, energyscape.npy or .npz) it draws a polar and a rectangular picture;
of raw recordings the microphones' signals, their spectrum and what the matched filter makes of them.

Examples:
  noctule plot images                            the first ping of what process wrote there
  noctule plot images --ping 12 --out pictures
  noctule plot corridor.wav --config robot.toml  what the microphones heard
  noctule plot ping.bin --sensor front --ping 0 --out pictures"
)]
pub struct PlotArguments {
    /// Results of process, or raw recordings.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Folder for the pictures; made if missing.
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// Ping to draw, counted from 0.
    #[arg(short, long, value_name = "N", default_value_t = 0)]
    pub ping: u64,
    /// Sensor whose array and geometry a raw recording has; the first without it.
    #[arg(long, value_name = "NAME")]
    pub sensor: Option<String>,
}
