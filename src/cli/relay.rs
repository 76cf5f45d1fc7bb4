//! `noctule relay`: copies for other machines.

use super::Failure;
use super::args::RelayArguments;
use super::run::{ipc_failure, service_failure, stop_flag};
use crate::io::{Ipc, Relay};
use crate::service::wiring;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Between two looks. The controller tells the platform something every 20 ms, and its topic keeps four.
const PAUSE: Duration = Duration::from_millis(2);

/// Passes samples on until it is told to stop.
///
/// # Errors
/// 78, and the codes of the transport.
pub fn relay(arguments: &RelayArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let setup = wiring::sensing(&config).map_err(|error| service_failure(&error.into()))?;
    let stop = stop_flag()?;
    let ipc = Ipc::open(&config.ipc).map_err(|error| ipc_failure(&error))?;
    let relay = Relay::open(&ipc, &setup.sensor_names(), &setup.cell_counts()).map_err(|error| ipc_failure(&error))?;
    log::info!("passing on to noctule/relay/... under {}", ipc.root().display());
    let mut passed = 0;
    while !stop.load(Ordering::Relaxed) {
        passed += relay.pass_on().map_err(|error| ipc_failure(&error))?;
        std::thread::sleep(PAUSE);
    }
    log::info!("{passed} samples passed on");
    Ok(())
}
