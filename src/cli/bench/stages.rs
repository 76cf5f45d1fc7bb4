//! Every stage and the whole ping set of one configuration on one backend, timed on simulated pings.
//!
//! In: a configuration with the number of sensors to take of it. Out: rows. Each configuration is measured in a process of its
//! own, so that its peak of memory is its own: [`in_own_process`] starts one, [`measure`] is what that one does.

use super::super::args::BenchArguments;
use super::super::process::backend_failure;
use super::super::{Failure, exit};
use super::quantiles::Quantiles;
use super::{DEADLINE_MS, WARM_UP, machine, simulated_pings};
use crate::config::Config;
use crate::control::Controller;
use crate::flow::MaskSet;
use crate::imaging::backend::Stage;
use crate::imaging::params::Prefer;
use crate::imaging::{Imager, ImagerOptions};
use crate::service::wiring;
use crate::signal::{PingSet, Velocity};
use serde::{Deserialize, Serialize};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Instant;

/// One stage of one configuration. The first eight fields are the specification's.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// `cpu` or `gpu`.
    pub backend: String,
    /// Instruction set or adapter.
    pub adapter: String,
    /// Sensors in a ping set.
    pub sensors: usize,
    /// Threads of the CPU backend.
    pub threads: usize,
    /// Stem of a stage, `image` or `total`.
    pub stage: String,
    /// Half of the ping sets took no longer.
    pub median_ms: f64,
    /// 99 of 100 took no longer.
    pub p99_ms: f64,
    /// None took longer.
    pub max_ms: f64,
    /// Counted multiply-adds, and bytes that must be moved; for `image` and `total` those of all stages.
    pub floor_operations: u64,
    /// See `floor_operations`.
    pub floor_bytes: u64,
    /// Largest resident set while ping sets were imaged, their raw samples included.
    pub peak_rss_bytes: Option<u64>,
}

/// What a process of its own prints: the rows of `bench --alone`.
#[derive(Deserialize)]
struct Printed {
    results: Vec<Row>,
}

/// The name of a backend on the command line.
fn name(prefer: Prefer) -> &'static str {
    match prefer {
        Prefer::Auto => "auto",
        Prefer::Gpu => "gpu",
        Prefer::Cpu => "cpu",
    }
}

/// Measures `count` sensors on a backend in a new process.
///
/// # Errors
/// That process's exit code, 69 without the backend asked for; it has said why.
pub fn in_own_process(arguments: &BenchArguments, count: usize, prefer: Prefer) -> Result<Vec<Row>, Failure> {
    let program = std::env::current_exe()
        .map_err(|error| Failure::new(exit::INTERNAL, format!("where is this program? {error}")))?;
    let mut command = Command::new(program);
    command.args(["bench", "--alone", "--backend", name(prefer), "--sensors", &count.to_string()]);
    command.args(["--iterations", &arguments.iterations.to_string()]);
    if let Some(path) = &arguments.choice.config {
        command.arg("--config").arg(path);
    }
    let output = command.stdin(Stdio::null()).output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    let code = output.status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(exit::INTERNAL);
    if code != 0 {
        let last = said.lines().last().unwrap_or("a measuring process failed").trim_start_matches("noctule: ");
        return Err(Failure::new(code, last));
    }
    let printed: Printed =
        serde_json::from_slice(&output.stdout).map_err(|error| Failure::new(exit::INTERNAL, error))?;
    Ok(printed.results)
}

/// Measures the first `count` sensors on a backend.
///
/// # Errors
/// Exit 69 when the backend is missing, 78 for what cannot be planned.
pub fn measure(config: &Config, count: usize, prefer: Prefer, iterations: u32) -> Result<Vec<Row>, Failure> {
    let refuse = |error| Failure::new(exit::CONFIG, error);
    let mut config = config.clone();
    config.sensor.truncate(count);
    // Regions that fewer sensors cannot see are no error here: the work is the same.
    let setup = wiring::sensing(&config).map_err(refuse)?;
    let masks = wiring::masks(&config, &setup).map_err(refuse)?;
    let pings = simulated_pings(&config, &setup)?;
    machine::forget_peak();
    let options = ImagerOptions { threads: None, gpu_deadline_ms: DEADLINE_MS };
    let mut imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), prefer, options)
        .map_err(|error| backend_failure(&error))?;
    imager.announce();
    let times = run_sets(&config, &mut imager, &masks, &pings, iterations)?;
    let peak_rss_bytes = machine::peak_rss_bytes();
    let (report, floor) = (imager.report(), setup.plan.floor(masks.table().cells.len()));
    let row = |stage: &str, times_ms: Vec<f64>, operations: u64, bytes: u64| {
        let times = Quantiles::of(times_ms);
        Row {
            backend: report.kind.as_str().to_owned(),
            adapter: report.adapter.clone(),
            sensors: count,
            threads: report.threads,
            stage: stage.to_owned(),
            median_ms: times.at(0.5),
            p99_ms: times.at(0.99),
            max_ms: times.at(1.0),
            floor_operations: operations,
            floor_bytes: bytes,
            peak_rss_bytes,
        }
    };
    let Times { stages, image, total } = times;
    let stages = Stage::ALL.into_iter().zip(stages).zip(floor);
    let mut rows: Vec<Row> =
        stages.map(|((stage, times_ms), floor)| row(stage.stem(), times_ms, floor.operations, floor.bytes)).collect();
    let (operations, bytes) =
        rows.iter().fold((0, 0), |sum, row| (sum.0 + row.floor_operations, sum.1 + row.floor_bytes));
    rows.push(row("image", image, operations, bytes));
    rows.push(row("total", total, operations, bytes));
    Ok(rows)
}

struct Times {
    stages: [Vec<f64>; Stage::ALL.len()],
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
