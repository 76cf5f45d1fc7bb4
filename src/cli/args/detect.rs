//! `noctule detect` as it may be typed.

use super::ConfigChoice;
use clap::{Args, ValueEnum};

/// Which detector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DetectorArgument {
    /// Vector projection on a planned edge (paper 001).
    Projection,
    /// Objects between neighbours of the virtual sonar ring (paper 003).
    Ring,
}

/// `detect`.
#[derive(Debug, Args)]
#[command(after_help = "Reads JSON from standard input, one object; metres and degrees, null in ranges_m for no echo.

Examples:
  echo '{\"ranges_m\": [null, null, null, 0.3563, 0.4199, null, null, null], \"pose\": {\"x_m\": 1.3, \"y_m\": 3.0, \"heading_deg\": 0},
    \"edge\": [[1, 3], [3, 3]]}' | noctule detect projection
  echo '{\"ranges_m\": [1, 1, null, null, null, null, null, null, null, null, null, null],
    \"pose\": {\"x_m\": 0, \"y_m\": 0, \"heading_deg\": 0}}' | noctule detect ring")]
pub struct DetectArguments {
    /// The detector.
    pub detector: DetectorArgument,
    /// Parameters: `[detect.projection]` and `[detect.ring]` of the configuration.
    #[command(flatten)]
    pub choice: ConfigChoice,
}
