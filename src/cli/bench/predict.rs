//! What the GPU backend should take on a card of given peaks, stage by stage, beside what it took here.
//!
//! In: a configuration, a card's peaks, the measured rows. Out: a table, or keys beside the rows of the JSON. The work is counted from
//! the very dispatches (`imaging::gpu::workload`); what a card makes of its peaks is assumed, as the constants say, until
//! somebody with a card compares the columns. Never measures.

use super::super::args::{BackendArgument, BenchArguments};
use super::super::output::print_line;
use super::super::{Failure, exit};
use super::stages::Row;
use crate::config::Config;
use crate::imaging::backend::Stage;
use crate::imaging::gpu::{DispatchWork, Memory, memory, transfer_bytes, workload};
use crate::service::wiring;
use clap::ValueEnum;
use serde_json::{Value, json};

/// Shares of the peaks that kernels like ours reach: most instructions are no multiply-adds and wait for one another.
const COMPUTE_EFFICIENCY: f64 = 0.25;
const MEMORY_EFFICIENCY: f64 = 0.7;
/// From one dispatch to the next: the barrier, the drained and the refilled card.
const DISPATCH_MS: f64 = 0.008;
/// Submission, fence, wake-up of the waiting thread.
const SUBMIT_MS: f64 = 0.1;
/// Bytes a second between processor and card, or a quarter of a slower memory's own rate where both share it.
const LINK_GB_S: f64 = 10.0;
/// Clock that peaks are divided by for the number of lanes, and threads a lane that hide the latency of memory.
const CLOCK_GHZ: f64 = 1.3;
const THREADS_PER_LANE: f64 = 8.0;

/// Cards that predictions are made for unless peaks are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CardName {
    /// 1,500 GFLOP/s and 100 GB/s, shared with the processor.
    JetsonOrin,
    /// 30,000 GFLOP/s and 1,000 GB/s of its own.
    Desktop,
}

/// Peaks of a card.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Card {
    name: &'static str,
    /// Single precision, a multiply-add being two.
    gflops: f64,
    gb_s: f64,
}

impl CardName {
    fn card(self) -> Card {
        match self {
            CardName::JetsonOrin => Card { name: "jetson-orin", gflops: 1500.0, gb_s: 100.0 },
            CardName::Desktop => Card { name: "desktop", gflops: 30_000.0, gb_s: 1000.0 },
        }
    }
}

impl Card {
    /// Time of a dispatch: the longer of arithmetic and memory, stretched where it leaves lanes idle.
    fn dispatch_ms(&self, work: &DispatchWork) -> f64 {
        let instructions_hz = 0.5e9 * self.gflops;
        let compute_ms = 1e3 * work.operations as f64 / (instructions_hz * COMPUTE_EFFICIENCY);
        let memory_ms = 1e3 * work.bytes as f64 / (1e9 * self.gb_s * MEMORY_EFFICIENCY);
        let lanes = instructions_hz / (1e9 * CLOCK_GHZ);
        let filled = (work.threads as f64 / (THREADS_PER_LANE * lanes)).min(1.0);
        compute_ms.max(memory_ms) / filled + DISPATCH_MS
    }

    fn stage_ms(&self, prediction: &Prediction, stage: Stage) -> f64 {
        prediction.of(stage).map(|work| self.dispatch_ms(work)).sum()
    }

    /// Time from raw samples in memory to the image there: stages, both transfers, one submission. Samples are copied once on the card;
    /// the result is poisoned before and copied after, each a read and a write.
    fn image_ms(&self, prediction: &Prediction) -> f64 {
        let stages: f64 = Stage::ALL.iter().map(|stage| self.stage_ms(prediction, *stage)).sum();
        let link_gb_s = LINK_GB_S.min(0.25 * self.gb_s);
        let moved_ms = (prediction.up_bytes + prediction.down_bytes) as f64 / (1e6 * link_gb_s);
        let copied = (2 * prediction.up_bytes + 4 * prediction.down_bytes) as f64;
        stages + moved_ms + copied / (1e6 * self.gb_s * MEMORY_EFFICIENCY) + SUBMIT_MS
    }
}

/// The counted work of a number of sensors.
struct Prediction {
    sensors: usize,
    dispatches: Vec<DispatchWork>,
    up_bytes: u64,
    down_bytes: u64,
    memory: Memory,
}

impl Prediction {
    fn new(config: &Config, sensors: usize) -> Result<Self, Failure> {
        let refuse = |error| Failure::new(exit::CONFIG, error);
        let mut config = config.clone();
        config.sensor.truncate(sensors);
        let setup = wiring::sensing(&config).map_err(refuse)?;
        let masks = wiring::masks(&config, &setup).map_err(refuse)?;
        let (plan, table) = (&setup.plan, masks.table());
        let (up_bytes, down_bytes) = transfer_bytes(plan, table);
        let unavailable = |error| Failure::new(exit::UNAVAILABLE, error);
        Ok(Self {
            sensors,
            dispatches: workload(plan, table).map_err(unavailable)?,
            up_bytes,
            down_bytes,
            memory: memory(plan, table).map_err(unavailable)?,
        })
    }

    fn of(&self, stage: Stage) -> impl Iterator<Item = &DispatchWork> {
        self.dispatches.iter().filter(move |work| work.stage == stage)
    }

    /// Instructions and bytes of a stage.
    fn sums(&self, stage: Stage) -> (u64, u64) {
        self.of(stage).fold((0, 0), |sum, work| (sum.0 + work.operations, sum.1 + work.bytes))
    }
}

/// The cards that were asked for; none unless the GPU was.
fn cards(arguments: &BenchArguments) -> Vec<Card> {
    match (arguments.peak_gflops, arguments.peak_gb_s, arguments.card) {
        (Some(gflops), Some(gb_s), _) => vec![Card { name: "this card", gflops, gb_s }],
        (_, _, Some(name)) => vec![name.card()],
        _ if matches!(arguments.backend, Some(BackendArgument::Gpu)) => {
            CardName::value_variants().iter().map(|name| name.card()).collect()
        }
        _ => Vec::new(),
    }
}

/// Predictions for every number of sensors among the rows; empty where none was asked for.
fn predictions(config: &Config, rows: &[Row]) -> Result<Vec<Prediction>, Failure> {
    let mut counts: Vec<usize> = rows.iter().map(|row| row.sensors).collect();
    counts.sort_unstable();
    counts.dedup();
    counts.into_iter().map(|sensors| Prediction::new(config, sensors)).collect()
}

/// Prints counted work and predictions, a line a stage.
///
/// # Errors
/// Exit 69 where a plan cannot be done on a GPU, 74 when standard output fails.
pub fn print(config: &Config, arguments: &BenchArguments, rows: &[Row]) -> Result<(), Failure> {
    let cards = cards(arguments);
    if cards.is_empty() {
        return Ok(());
    }
    let columns: String = cards.iter().map(|card| format!(" {:>12}", card.name)).collect();
    print_line("\nthe GPU backend by counting; predicted ms:")?;
    print_line(&format!(
        "{:>7} {:16} {:>10} {:>10} {:>8} {:>10} {:>9} {:>9}{columns}",
        "sensors", "stage", "dispatches", "workgroups", "threads", "10^6 ops", "MB", "measured"
    ))?;
    for prediction in predictions(config, rows)? {
        let measured = |stage: &str| {
            let row =
                rows.iter().find(|row| row.backend == "gpu" && row.sensors == prediction.sensors && row.stage == stage);
            row.map_or("-".to_owned(), |row| format!("{:.3}", row.median_ms))
        };
        for stage in Stage::ALL {
            let times: String =
                cards.iter().map(|card| format!(" {:>12.3}", card.stage_ms(&prediction, stage))).collect();
            let (operations, bytes) = prediction.sums(stage);
            print_line(&format!(
                "{:>7} {:16} {:>10} {:>10} {:>8} {:>10.1} {:>9.2} {:>9}{times}",
                prediction.sensors,
                stage.stem(),
                prediction.of(stage).count(),
                prediction.of(stage).map(|work| work.workgroups).min().unwrap_or(0),
                prediction.of(stage).map(|work| work.threads).min().unwrap_or(0),
                operations as f64 * 1e-6,
                bytes as f64 * 1e-6,
                measured(stage.stem())
            ))?;
        }
        let times: String = cards.iter().map(|card| format!(" {:>12.3}", card.image_ms(&prediction))).collect();
        let moved = (prediction.up_bytes + prediction.down_bytes) as f64 * 1e-6;
        let (sensors, image) = (prediction.sensors, measured("image"));
        print_line(&format!("{sensors:>7} {:16} {:>51.2} {image:>9}{times}", "image", moved))?;
        let Memory { buffer_bytes, largest_binding_bytes, tile_count, bank_count } = prediction.memory;
        print_line(&format!(
            "{sensors:>7} buffers {:.1} MB, largest binding {:.1} MB, {tile_count} tiles of directions, {bank_count} banks of sensors",
            buffer_bytes as f64 * 1e-6,
            largest_binding_bytes as f64 * 1e-6
        ))?;
    }
    print_line(&format!(
        "workgroups, threads: of the stage's smallest dispatch; MB of image: samples up, energyscapes down; assumed: {:.0} % of the peak \
         of arithmetic, {:.0} % of memory's,\n{:.0} us a dispatch, {:.0} us a submission, {LINK_GB_S} GB/s to the card, \
         {THREADS_PER_LANE} threads a lane to fill it. `--peak-gflops` and `--peak-gb-s` take your card's figures.",
        100.0 * COMPUTE_EFFICIENCY,
        100.0 * MEMORY_EFFICIENCY,
        1e3 * DISPATCH_MS,
        1e3 * SUBMIT_MS
    ))
}

/// Adds `predicted_ms` by card, `gpu_operations` and `gpu_bytes` to the JSON of the GPU's rows.
///
/// # Errors
/// As [`print()`].
pub fn extend(config: &Config, arguments: &BenchArguments, rows: &[Row], results: &mut [Value]) -> Result<(), Failure> {
    let cards = cards(arguments);
    if cards.is_empty() {
        return Ok(());
    }
    let predictions = predictions(config, rows)?;
    for (row, result) in rows.iter().zip(results).filter(|(row, _)| row.backend == "gpu") {
        let Some(prediction) = predictions.iter().find(|prediction| prediction.sensors == row.sensors) else {
            continue;
        };
        let stage = Stage::ALL.into_iter().find(|stage| stage.stem() == row.stage);
        let predicted_ms = |card: &Card| match stage {
            Some(stage) => card.stage_ms(prediction, stage),
            None => card.image_ms(prediction),
        };
        if let Some(stage) = stage {
            let (operations, bytes) = prediction.sums(stage);
            result["gpu_operations"] = json!(operations);
            result["gpu_bytes"] = json!(bytes);
        }
        let times = cards.iter().map(|card| (card.name.to_owned(), json!(predicted_ms(card)))).collect();
        result["predicted_ms"] = Value::Object(times);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORK: DispatchWork = DispatchWork {
        stage: Stage::Envelope,
        workgroups: 2000,
        threads: 128_000,
        operations: 10_000_000,
        bytes: 1_000_000,
    };

    #[test]
    fn the_longer_of_arithmetic_and_memory_decides() {
        let card = Card { name: "", gflops: 1000.0, gb_s: 100.0 };
        // 10^7 instructions at a quarter of 5 * 10^11 a second.
        assert!((card.dispatch_ms(&WORK) - (0.08 + DISPATCH_MS)).abs() < 1e-9);
        let moved = DispatchWork { bytes: 70_000_000, ..WORK };
        assert!((card.dispatch_ms(&moved) - (1.0 + DISPATCH_MS)).abs() < 1e-9);
    }

    #[test]
    fn a_dispatch_too_small_for_the_card_is_stretched() {
        let card = Card { name: "", gflops: 26_000.0, gb_s: 1000.0 };
        // 10,000 lanes want 80,000 threads.
        let (full, small) = (card.dispatch_ms(&WORK), card.dispatch_ms(&DispatchWork { threads: 8000, ..WORK }));
        assert!((small - DISPATCH_MS - 10.0 * (full - DISPATCH_MS)).abs() < 1e-9, "{full} {small}");
    }
}
