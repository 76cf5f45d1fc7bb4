//! `noctule bench`: every stage and the whole ping set, one to three sensors, each backend, on simulated pings, beside the counted
//! floor; with `--beamformers` what each beamformer makes of the same scenes, with `--emissions` what each emission plan is worth, with `--latency` the way from last sample to command, with `--scaling` time against sizes.

mod beamformers;
mod emissions;
mod hop;
mod latency;
mod machine;
mod place;
#[cfg(feature = "gpu")]
mod predict;
mod quantiles;
mod scaling;
mod stages;
mod table;

#[cfg(feature = "gpu")]
pub use predict::CardName;
pub use scaling::Case;

use super::args::{BackendArgument, BenchArguments};
use super::output::print_line;
use super::series::cores;
use super::{Failure, exit};
use crate::config::Config;
use crate::imaging::params::Prefer;
use crate::service::wiring::SensingSetup;
use crate::signal::{PingSet, SENSORS_MAX, Velocity};
use crate::sim::{SimParams, World};
use crate::time::{Clock, SystemClock};
use machine::Rates;
use serde_json::{Value, json};

/// Ping sets before the clock counts: caches, pipelines, frequencies.
const WARM_UP: u32 = 5;
/// A software adapter may take its time here; only a hang is given up.
const DEADLINE_MS: u64 = 10_000;

/// Runs the command.
///
/// # Errors
/// Exit 69 when the backend asked for is missing, 78.
pub fn bench(arguments: &BenchArguments) -> Result<(), Failure> {
    if let Some(case) = arguments.scaling_row {
        return scaling::row(case, arguments);
    }
    if arguments.plot.is_some() && !(arguments.scaling || arguments.beamformers || arguments.emissions) {
        return Err(Failure::new(
            exit::USAGE,
            "--plot: found without --scaling, --beamformers or --emissions, one of which it draws",
        ));
    }
    let config = super::config::load(&arguments.choice)?;
    if arguments.scaling {
        return scaling::scaling(&config, arguments);
    }
    if arguments.beamformers {
        return beamformers::beamformers(&config, arguments);
    }
    if arguments.emissions {
        return emissions::emissions(&config, arguments);
    }
    if arguments.latency {
        return latency::latency(&config, arguments);
    }
    if let Some(count) = arguments.sensors.filter(|count| *count as usize > config.sensor.len()) {
        let message = format!("--sensors: found {count}, the configuration has {}", config.sensor.len());
        return Err(Failure::new(exit::USAGE, message));
    }
    if let (true, Some(count), Some(backend)) = (arguments.alone, arguments.sensors, arguments.backend) {
        let rows = stages::measure(&config, count as usize, backend.into(), arguments.iterations)?;
        return print_line(&json!({"machine": machine(&config), "results": rows}).to_string());
    }
    let rows = measure_all(&config, arguments)?;
    let rates = Rates::measure();
    if arguments.json {
        let mut machine = machine(&config);
        machine["multiply_adds_per_s"] = json!(rates.multiply_adds_hz);
        machine["memory_bytes_per_s"] = json!(rates.memory_bytes_s);
        let result = |row: &stages::Row| {
            let mut value = json!(row);
            value["floor_ms"] = json!(rates.floor_ms(row.floor_operations, row.floor_bytes));
            value
        };
        #[allow(unused_mut, reason = "the GPU is a feature")]
        let mut results: Vec<Value> = rows.iter().map(result).collect();
        #[cfg(feature = "gpu")]
        predict::extend(&config, arguments, &rows, &mut results)?;
        return print_line(&json!({"machine": machine, "results": results}).to_string());
    }
    table::print(config.recording.format.as_str(), &rows, &rates)?;
    #[cfg(feature = "gpu")]
    predict::print(&config, arguments, &rows)?;
    Ok(())
}

fn measure_all(config: &Config, arguments: &BenchArguments) -> Result<Vec<stages::Row>, Failure> {
    let prefers: &[Prefer] = match arguments.backend {
        Some(BackendArgument::Cpu) => &[Prefer::Cpu],
        Some(BackendArgument::Gpu) => &[Prefer::Gpu],
        Some(BackendArgument::Auto) => &[Prefer::Auto],
        None => &[Prefer::Cpu, Prefer::Gpu],
    };
    let counts = match arguments.sensors {
        Some(count) => count as usize..=count as usize,
        None => 1..=config.sensor.len().min(SENSORS_MAX),
    };
    let mut rows = Vec::new();
    for prefer in prefers {
        for count in counts.clone() {
            match stages::in_own_process(arguments, count, *prefer) {
                Ok(measured) => rows.extend(measured),
                // Asked for nothing in particular, a missing GPU is a line, not a failure.
                Err(failure) if arguments.backend.is_none() && failure.code == exit::UNAVAILABLE => {
                    log::warn!("{}", failure.message);
                    break;
                }
                Err(failure) => return Err(failure),
            }
        }
    }
    Ok(rows)
}

/// What the figures were measured on.
fn machine(config: &Config) -> Value {
    json!({
        "cores": cores(),
        "architecture": std::env::consts::ARCH,
        "os": std::env::consts::OS,
        "noctule_version": env!("CARGO_PKG_VERSION"),
        "format": config.recording.format.as_str(),
    })
}

/// Several different ping sets, so that no cache sees the same samples twice in a row.
fn simulated_pings(config: &Config, setup: &SensingSetup) -> Result<Vec<PingSet>, Failure> {
    let world = World::default_world().map_err(|error| Failure::new(exit::INTERNAL, error))?;
    let mut simulator = crate::service::simulator(config, setup, world, SimParams::default(), 1)
        .map_err(|error| Failure::new(exit::DATA, error))?;
    let mut sets = Vec::new();
    for _ in 0..4 {
        let mut pings = simulator.empty_ping_set();
        simulator.ping_set(SystemClock.now(), &mut pings);
        simulator.step(Velocity::forward_m_s(0.3), 0.1);
        sets.push(pings);
    }
    Ok(sets)
}
