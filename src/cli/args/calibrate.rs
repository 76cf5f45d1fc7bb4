//! `calibrate`, as it may be typed.

use super::ConfigChoice;
use crate::sensor::air::AIR_TEMPERATURE_C;
use clap::Args;
use std::path::PathBuf;

/// `calibrate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Record a minute in the open, robot moving or not, and tell the thermometer's reading: the direct path alone cannot tell
a warmer air from a larger array. Then name the file in the configuration: [calibration] file = \"calibration.toml\", with
apply = [\"emitter\", \"gains\"].

Examples:
  noctule calibrate quiet.mcap --out calibration.toml --air-temperature-c 21.5
  noctule calibrate front1.bin front2.bin --config robot.toml --sensor front --out calibration.toml
  noctule calibrate a.npy --config robot.toml --out calibration.toml --json"
)]
pub struct CalibrateArguments {
    /// Recordings: .npy, .npz, .wav, .bin of one sensor, or .mcap of noctule, which holds all sensors.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// File to write.
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Sensor that the recordings are of; of an .mcap all without it, else the first.
    #[arg(long, value_name = "NAME")]
    pub sensor: Option<String>,
    /// Temperature of the air then, by a thermometer of half a degree; without it the air is known to 18 degrees only.
    #[arg(long, value_name = "T", value_parser = temperature, allow_hyphen_values = true)]
    pub air_temperature_c: Option<f64>,
    /// How well each coordinate of the emitter is known: standard deviation in millimetres.
    #[arg(long, value_name = "MM", default_value_t = 2.0, value_parser = tolerance)]
    pub emitter_sd_mm: f64,
    /// How well the microphones' places are known.
    #[arg(long, value_name = "MM", default_value_t = 0.5, value_parser = tolerance)]
    pub place_sd_mm: f64,
    /// How well it is known that sample 0 is the first of the emission, in microseconds.
    #[arg(long, value_name = "US", default_value_t = 3.0, value_parser = tolerance)]
    pub late_sd_us: f64,
    /// How well the distance between two sensors is known that hear each other, in millimetres.
    #[arg(long, value_name = "MM", default_value_t = 2.0, value_parser = tolerance)]
    pub mount_sd_mm: f64,
    /// Print what was measured as one JSON object.
    #[arg(long)]
    pub json: bool,
}

fn number(text: &str, (least, most): (f64, f64)) -> Result<f64, String> {
    let found = text.parse::<f64>().ok().filter(|value| *value >= least && *value <= most);
    found.ok_or_else(|| format!("found {text}, allowed: a number from {least} to {most}"))
}

fn temperature(text: &str) -> Result<f64, String> {
    number(text, AIR_TEMPERATURE_C)
}

fn tolerance(text: &str) -> Result<f64, String> {
    number(text, (1e-3, 100.0))
}
