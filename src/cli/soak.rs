//! `noctule soak`: a simulated robot drives while something goes wrong every minute, and is scored.

use super::args::SoakArguments;
use super::output::{print_line, progress};
use super::run::{prefer_pcm, service_failure};
use super::{Failure, exit};
use crate::service::soak::{SoakOptions, soak};
use crate::service::trial::TrialRig;
use crate::sim::World;

/// Steps of the progress bar.
const STEPS: u64 = 1000;

/// Runs the command: one JSON object on standard output.
///
/// # Errors
/// Exit 1 when the robot moved when it must not, stopped too late or too often, or the process grew; 78 for a configuration that
/// cannot be used, 70 when the robot could not be driven at all.
pub fn soak_command(arguments: &SoakArguments) -> Result<(), Failure> {
    let mut config = super::config::load(&arguments.choice)?;
    prefer_pcm(&mut config);
    let rig = TrialRig::new(config).map_err(|error| service_failure(&error))?;
    let world = World::default_world().map_err(|error| Failure::new(exit::DATA, error))?;
    let options =
        SoakOptions { minutes: arguments.minutes, seed: arguments.seed, fault_every_s: arguments.fault_every };
    let bar = progress(STEPS, "soaking");
    let summary = soak(&rig, &world, &options, &mut |share| bar.set_position((share * STEPS as f64) as u64));
    bar.finish_and_clear();
    let summary = summary.map_err(|error| service_failure(&error))?;
    let json = serde_json::to_string_pretty(&summary).map_err(|error| Failure::new(exit::INTERNAL, error))?;
    print_line(&json)?;
    for finding in &summary.findings {
        log::error!("{finding}");
    }
    if summary.findings.is_empty() { Ok(()) } else { Err(Failure::new(exit::FINDING, "")) }
}
