//! The rows of `noctule bench` side by side: a line a stage, a pair of columns a backend, the counted floor beside them.

use super::super::Failure;
use super::super::output::print_line;
use super::machine::Rates;
use super::stages::Row;

/// Prints the table, what each backend ran on, its peak of memory, and what the machine can do.
///
/// # Errors
/// Exit 74 when standard output fails.
pub fn print(format: &str, rows: &[Row], rates: &Rates) -> Result<(), Failure> {
    let mut backends: Vec<&str> = Vec::new();
    rows.iter().for_each(|row| {
        if !backends.contains(&row.backend.as_str()) {
            backends.push(&row.backend);
        }
    });
    print_line(&format!("raw data: {format}; times in ms"))?;
    let columns: String = backends
        .iter()
        .map(|backend| format!(" {:>10} {:>9}", format!("{backend} p50"), format!("{backend} p99")))
        .collect();
    print_line(&format!("{:>7} {:16}{columns} {:>9} {:>9} {:>8}", "sensors", "stage", "floor", "10^6 ops", "MB"))?;
    for first in rows.iter().filter(|row| row.backend == rows[0].backend) {
        let of = |backend: &&str| {
            rows.iter().find(|row| row.backend == **backend && row.sensors == first.sensors && row.stage == first.stage)
        };
        let times: String = backends
            .iter()
            .map(|backend| match of(backend) {
                Some(row) => format!(" {:>10.3} {:>9.3}", row.median_ms, row.p99_ms),
                None => format!(" {:>10} {:>9}", "-", "-"),
            })
            .collect();
        print_line(&format!(
            "{:>7} {:16}{times} {:>9.3} {:>9.2} {:>8.2}",
            first.sensors,
            first.stage,
            rates.floor_ms(first.floor_operations, first.floor_bytes),
            first.floor_operations as f64 * 1e-6,
            first.floor_bytes as f64 * 1e-6,
        ))?;
    }
    for backend in backends {
        let of_backend = || rows.iter().filter(|row| row.backend == backend && row.stage == "total");
        let Some(row) = of_backend().next() else { continue };
        let peaks: Vec<String> = of_backend()
            .map(|row| row.peak_rss_bytes.map_or("-".to_owned(), |bytes| format!("{:.0}", bytes as f64 / 1_048_576.0)))
            .collect();
        let (adapter, threads) = (&row.adapter, row.threads);
        print_line(&format!("{backend}: {adapter}, {threads} threads; peak memory {} MiB", peaks.join(", ")))?;
    }
    print_line(&format!(
        "floor: counted multiply-adds at {:.0} * 10^9/s or bytes at {:.1} GB/s, as measured here just now on all cores",
        rates.multiply_adds_hz * 1e-9,
        rates.memory_bytes_s * 1e-9
    ))
}
