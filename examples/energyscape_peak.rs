//! Follows the strongest echo of one sensor: the pattern for a reader in Rust. One line a ping, as the Python and C examples print it.
//!
//!     cargo run --release --example energyscape_peak -- [--config robot.toml] [--sensor NAME] [--count N] [--timeout S]

use clap::Parser;
use noctule::config::Config;
use noctule::io::wire::message::EnergyscapeHeader;
use noctule::io::{EnergyscapeReader, Ipc};
use noctule::time::{Clock, SystemClock};
use std::path::PathBuf;
use std::time::{Duration, Instant};

#[derive(Parser)]
struct Arguments {
    /// The configuration that noctule runs with.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Default: the first.
    #[arg(long)]
    sensor: Option<String>,
    /// End after this many pings.
    #[arg(long)]
    count: Option<u64>,
    /// Longest wait for a ping, in seconds.
    #[arg(long, default_value_t = 5.0)]
    timeout: f64,
}

/// The strongest cell of an image: direction, range bin, value. NaN is never the strongest.
fn strongest(header: &EnergyscapeHeader, cells: &[f32]) -> (usize, usize, f32) {
    let strongest =
        cells.iter().copied().enumerate().fold((0, 0.0), |best, cell| if cell.1 > best.1 { cell } else { best });
    let ranges = header.range_count as usize;
    (strongest.0 / ranges, strongest.0 % ranges, strongest.1)
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let config = arguments.config.map_or_else(|| Ok(Config::default()), |path| Config::load(&path))?;
    let first = config.sensor.first().map(|sensor| sensor.name.clone());
    let sensor = arguments.sensor.or(first).ok_or_else(|| anyhow::anyhow!("the configuration has no sensor"))?;
    let images = EnergyscapeReader::open(&Ipc::open(&config.ipc)?, &sensor)?;

    let (mut printed, mut before, mut heard) = (0, None, Instant::now());
    while arguments.count.is_none_or(|count| printed < count) {
        // The closure sees the image where the daemon wrote it: only three numbers are taken along.
        let Some((header, (direction, column, value))) =
            images.newest(|header, cells| (*header, strongest(header, cells)))
        else {
            anyhow::ensure!(heard.elapsed().as_secs_f64() < arguments.timeout, "no ping for {} s", arguments.timeout);
            std::thread::sleep(Duration::from_millis(2));
            continue;
        };
        heard = Instant::now();
        println!(
            "range_m={:.4} bearing_deg={:.3} value={value:.6} sequence={} t_monotonic_ns={} age_ms={:.1} lost={}",
            header.range_first_m + column as f64 * header.range_step_m,
            (header.direction_first_rad + direction as f64 * header.direction_step_rad).to_degrees(),
            header.sequence,
            header.t_monotonic_ns,
            SystemClock.now().boottime_ns.saturating_sub(header.t_monotonic_ns) as f64 / 1e6,
            before.map_or(0, |before: u64| header.sequence.saturating_sub(before + 1)),
        );
        before = Some(header.sequence);
        printed += 1;
    }
    Ok(())
}
