//! `noctule bench`: every stage and the whole ping set, one to three sensors, each backend, on simulated pings.

mod hop;
mod latency;
mod place;
mod quantiles;

use super::args::{BackendArgument, BenchArguments};
use super::output::print_line;
use super::process::backend_failure;
use super::{Failure, exit};
use crate::config::Config;
use crate::control::Controller;
use crate::flow::MaskSet;
use crate::imaging::backend::Stage;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::service::wiring::{self, SensingSetup};
use crate::signal::{PingSet, SENSORS_MAX, Velocity};
use crate::sim::{SimParams, World};
use crate::time::{Clock, SystemClock};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Instant;

/// Ping sets before the clock counts: caches, pipelines, frequencies.
const WARM_UP: u32 = 5;
/// A software adapter may take its time here; only a hang is given up.
const DEADLINE_MS: u64 = 10_000;

struct Row {
    backend: &'static str,
    adapter: String,
    sensors: usize,
    threads: usize,
    stage: &'static str,
    times_ms: Vec<f64>,
}

impl Row {
    fn percentile(&self, share: f64) -> f64 {
        let rank = (share * self.times_ms.len() as f64).ceil() as usize;
        self.times_ms.get(rank.clamp(1, self.times_ms.len()) - 1).copied().unwrap_or(0.0)
    }

    fn json(&self) -> Value {
        json!({
            "backend": self.backend,
            "adapter": self.adapter,
            "sensors": self.sensors,
            "threads": self.threads,
            "stage": self.stage,
            "median_ms": self.percentile(0.5),
            "p99_ms": self.percentile(0.99),
            "max_ms": self.percentile(1.0),
        })
    }
}

/// Runs the command.
///
/// # Errors
/// Exit 69 when the backend asked for is missing, 78.
pub fn bench(arguments: &BenchArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    if arguments.latency {
        return latency::latency(&config, arguments);
    }
    let prefers: &[Prefer] = match arguments.backend {
        Some(BackendArgument::Cpu) => &[Prefer::Cpu],
        Some(BackendArgument::Gpu) => &[Prefer::Gpu],
        Some(BackendArgument::Auto) => &[Prefer::Auto],
        None => &[Prefer::Cpu, Prefer::Gpu],
    };
    let mut rows = Vec::new();
    for count in 1..=config.sensor.len().min(SENSORS_MAX) {
        for prefer in prefers {
            match measure(&config, count, *prefer, arguments.iterations) {
                Ok(measured) => rows.extend(measured),
                // Asked for nothing in particular, a missing GPU is a line, not a failure.
                Err(failure) if arguments.backend.is_none() && failure.code == exit::UNAVAILABLE => {
                    log::warn!("{}", failure.message);
                }
                Err(failure) => return Err(failure),
            }
        }
    }
    if arguments.json {
        let machine = machine(&config);
        let results: Vec<Value> = rows.iter().map(Row::json).collect();
        return print_line(&json!({"machine": machine, "results": results}).to_string());
    }
    print_table(&config, &rows)
}

/// What the figures were measured on.
fn machine(config: &Config) -> Value {
    json!({
        "cores": std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
        "architecture": std::env::consts::ARCH,
        "os": std::env::consts::OS,
        "noctule_version": env!("CARGO_PKG_VERSION"),
        "format": config.recording.format.as_str(),
    })
}

fn print_table(config: &Config, rows: &[Row]) -> Result<(), Failure> {
    print_line(&format!("raw data: {}; times in ms", config.recording.format.as_str()))?;
    print_line(&format!(
        "{:8} {:>7} {:>7} {:16} {:>9} {:>9} {:>9}",
        "backend", "sensors", "threads", "stage", "median", "p99", "max"
    ))?;
    for row in rows {
        print_line(&format!(
            "{:8} {:>7} {:>7} {:16} {:>9.3} {:>9.3} {:>9.3}",
            row.backend,
            row.sensors,
            row.threads,
            row.stage,
            row.percentile(0.5),
            row.percentile(0.99),
            row.percentile(1.0)
        ))?;
    }
    let mut adapters: Vec<String> = rows.iter().map(|row| format!("{}: {}", row.backend, row.adapter)).collect();
    adapters.dedup();
    adapters.sort();
    adapters.dedup();
    adapters.iter().try_for_each(|adapter| print_line(adapter))
}

fn measure(config: &Config, count: usize, prefer: Prefer, iterations: u32) -> Result<Vec<Row>, Failure> {
    let refuse = |error| Failure::new(exit::CONFIG, error);
    let mut config = config.clone();
    config.sensor.truncate(count);
    // Regions that fewer sensors cannot see are no error here: the work is the same.
    let setup = wiring::sensing(&config).map_err(refuse)?;
    let masks = wiring::masks(&config, &setup).map_err(refuse)?;
    let options = ImagerOptions { threads: None, gpu_deadline_ms: DEADLINE_MS };
    let mut imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), prefer, options)
        .map_err(|error| backend_failure(&error))?;
    imager.announce();
    let pings = simulated_pings(&config, &setup)?;
    let times = run_sets(&config, &mut imager, &masks, &pings, iterations)?;
    let report = imager.report();
    let row = |stage: &'static str, mut times_ms: Vec<f64>| {
        times_ms.sort_by(f64::total_cmp);
        Row {
            backend: report.kind.as_str(),
            adapter: report.adapter.clone(),
            sensors: count,
            threads: report.threads,
            stage,
            times_ms,
        }
    };
    let Times { stages, image, total } = times;
    let mut rows: Vec<Row> =
        Stage::ALL.into_iter().zip(stages).map(|(stage, times_ms)| row(stage.stem(), times_ms)).collect();
    rows.push(row("image", image));
    rows.push(row("total", total));
    Ok(rows)
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

struct Times {
    stages: [Vec<f64>; 5],
    image: Vec<f64>,
    total: Vec<f64>,
}

fn run_sets(
    config: &Config,
    imager: &mut Imager,
    masks: &MaskSet,
    pings: &[PingSet],
    iterations: u32,
) -> Result<Times, Failure> {
    let mut controller = Controller::new(&config.control, &config.platform);
    let mut times = Times { stages: Default::default(), image: Vec::new(), total: Vec::new() };
    for (index, set) in pings.iter().cycle().take((iterations + WARM_UP) as usize).enumerate() {
        let start = Instant::now();
        let image = imager.image(set).map_err(|error| backend_failure(&error))?;
        let imaged_ms = start.elapsed().as_secs_f64() * 1e3;
        let cues = masks.fuse(&image.sums, image.imaged, set.emitted_at, set.sequence);
        let decision = controller.step(set.emitted_at, &cues, Velocity::forward_m_s(0.3));
        std::hint::black_box(decision);
        let total_ms = start.elapsed().as_secs_f64() * 1e3;
        if index < WARM_UP as usize {
            continue;
        }
        times.image.push(imaged_ms);
        times.total.push(total_ms);
        for (kept, time_ns) in times.stages.iter_mut().zip(imager.stage_times_ns()) {
            kept.push(time_ns as f64 * 1e-6);
        }
    }
    Ok(times)
}
