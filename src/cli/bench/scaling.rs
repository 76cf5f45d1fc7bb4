//! `noctule bench --scaling`: time and memory of a ping set against microphones, directions, sensors and samples.
//!
//! In: nothing but the backend; arrays, directions and noise are made here. Out: a table, JSON, a plot. Each row is measured in a
//! process of its own, so that its peak of memory is its own. Beside each time stands the counted floor of operations.

use super::super::args::{BackendArgument, BenchArguments};
use super::super::output::{print_line, progress, write_picture};
use super::super::process::backend_failure;
use super::super::{Failure, exit};
use super::quantiles::Quantiles;
use crate::config::Config;
use crate::imaging::params::ImagingParams;
use crate::imaging::plan::ImagingPlan;
use crate::imaging::{Imager, ImagerOptions};
use crate::io::plot::{CurvePanel, CurvePoint, curves};
use crate::sensor::{Emission, EmissionParams, MicrophoneArray, Mount, RecordingFormat, SensorSetup};
use crate::signal::{Direction, MaskTable, PingSet, SampleFormat, Samples};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fmt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Instant;

/// The row that all axes share.
const BASE: Case = Case { microphones: 32, directions: 180, spatial: false, sensors: 1, samples: 16_384 };
/// Speed of sound of the built-in robot.
const SPEED_OF_SOUND_M_S: f64 = 343.0;
/// Radius of an array of 32 microphones; others have the same area for each microphone, as an array that grows has.
const RADIUS_M: f64 = 0.04;
/// Farthest range asked for: the built-in robot's, or what a shorter ping can hear.
const RANGE_MAX_M: f64 = 5.0;

/// What is imaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Case {
    microphones: usize,
    directions: usize,
    /// Directions all over the half sphere ahead instead of a horizontal fan.
    spatial: bool,
    sensors: usize,
    samples: usize,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Case { microphones, directions, sensors, samples, .. } = self;
        write!(f, "{microphones},{directions},{},{sensors},{samples}", u8::from(self.spatial))
    }
}

impl FromStr for Case {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<usize> = text.split(',').filter_map(|number| number.parse().ok()).collect();
        let [microphones, directions, spatial, sensors, samples] = numbers[..] else {
            return Err(format!("found {text}, allowed: microphones,directions,0 or 1,sensors,samples"));
        };
        Ok(Self { microphones, directions, spatial: spatial == 1, sensors, samples })
    }
}

/// What is varied, from small to large.
fn axes() -> Vec<(&'static str, Vec<Case>)> {
    let of = |values: &[usize], change: fn(&mut Case, usize)| {
        let case = |value: &usize| {
            let mut case = BASE;
            change(&mut case, *value);
            case
        };
        values.iter().map(case).collect()
    };
    vec![
        ("microphones", of(&[8, 16, 32, 64, 128, 256], |case, value| case.microphones = value)),
        ("directions", of(&[90, 180, 360, 720, 1000, 2000, 4000], |case, value| case.directions = value)),
        (
            "directions in 3-D",
            of(&[500, 1000, 2000, 4000], |case, value| (case.directions, case.spatial) = (value, true)),
        ),
        ("sensors", of(&[1, 2, 3], |case, value| case.sensors = value)),
        ("samples", of(&[4096, 8192, 16_384, 32_768], |case, value| case.samples = value)),
    ]
}

/// A measured row.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Row {
    #[serde(flatten)]
    case: Case,
    ranges: usize,
    backend: String,
    adapter: String,
    threads: usize,
    median_ms: f64,
    p99_ms: f64,
    min_ms: f64,
    /// Largest resident set of a process that does nothing else; `None` where the system does not tell.
    peak_rss_bytes: Option<u64>,
    /// What a ping set brings in and what its image takes.
    raw_bytes: u64,
    image_bytes: u64,
    floor_operations: u64,
    floor_bytes: u64,
}

/// Runs the command.
///
/// # Errors
/// Exit 69 without the backend asked for, 70 when a row's process fails, 73 for a plot that cannot be written.
pub fn scaling(config: &Config, arguments: &BenchArguments) -> Result<(), Failure> {
    let axes = axes();
    let bar = progress(axes.iter().map(|(_, cases)| cases.len() as u64).sum(), "measuring");
    let mut measured = Vec::new();
    for (axis, cases) in axes {
        let mut rows = Vec::new();
        for case in cases {
            rows.push(in_own_process(case, arguments)?);
            bar.inc(1);
        }
        measured.push((axis, rows));
    }
    bar.finish_and_clear();
    if let Some(path) = &arguments.plot {
        write_picture(path, &picture(&measured))?;
    }
    if arguments.json {
        let rows: Vec<Value> = measured
            .iter()
            .flat_map(|(axis, rows)| rows.iter().map(move |row| (axis, row)))
            .map(|(axis, row)| {
                let mut value = json!(row);
                value["axis"] = json!(axis);
                value
            })
            .collect();
        return print_line(&json!({"machine": super::machine(config), "scaling": rows}).to_string());
    }
    print_table(&measured)
}

fn print_table(measured: &[(&str, Vec<Row>)]) -> Result<(), Failure> {
    if let Some(row) = measured.first().and_then(|(_, rows)| rows.first()) {
        print_line(&format!(
            "pcm-f32, raw ping set to energyscapes; {} ({}), {} threads",
            row.backend, row.adapter, row.threads
        ))?;
    }
    for (axis, rows) in measured {
        print_line(&format!("\n{axis}"))?;
        print_line(&format!(
            "{:>5} {:>10} {:>7} {:>8} {:>7} {:>9} {:>9} {:>10} {:>9} {:>9}",
            "mics", "directions", "sensors", "samples", "ranges", "ms", "p99 ms", "peak MiB", "10^6 ops", "ops/ns"
        ))?;
        for row in rows {
            let Case { microphones, directions, sensors, samples, .. } = row.case;
            let peak = row.peak_rss_bytes.map_or("-".to_owned(), |bytes| format!("{:.0}", bytes as f64 / 1048576.0));
            print_line(&format!(
                "{microphones:>5} {directions:>10} {sensors:>7} {samples:>8} {:>7} {:>9.3} {:>9.3} {peak:>10} {:>9.1} {:>9.1}",
                row.ranges,
                row.median_ms,
                row.p99_ms,
                row.floor_operations as f64 * 1e-6,
                row.floor_operations as f64 / (row.median_ms * 1e6),
            ))?;
        }
    }
    Ok(())
}

fn picture(measured: &[(&str, Vec<Row>)]) -> crate::io::picture::Picture {
    let value = |axis: &str, case: &Case| match axis {
        "microphones" => case.microphones,
        "sensors" => case.sensors,
        "samples" => case.samples,
        _ => case.directions,
    };
    let panels: Vec<CurvePanel> = measured
        .iter()
        .map(|(axis, rows)| {
            let first = rows.first().map_or(1.0, |row| row.median_ms / row.floor_operations.max(1) as f64);
            let point = |row: &Row| CurvePoint {
                x: value(axis, &row.case) as f64,
                measured: row.median_ms,
                expected: first * row.floor_operations as f64,
            };
            CurvePanel { x_title: (*axis).to_owned(), points: rows.iter().map(point).collect() }
        })
        .collect();
    let adapter = measured
        .first()
        .and_then(|(_, rows)| rows.first())
        .map_or(String::new(), |row| format!("{} ({}), {} threads", row.backend, row.adapter, row.threads));
    let second =
        format!("32 microphones, 180 directions, 1 sensor, 16,384 samples of f32 but for what is varied; {adapter}");
    curves(
        &panels,
        ["Time of a ping set, raw samples to energyscapes", &second],
        "ms",
        ["measured", "first row times the counted operations"],
    )
}

fn in_own_process(case: Case, arguments: &BenchArguments) -> Result<Row, Failure> {
    let program = std::env::current_exe()
        .map_err(|error| Failure::new(exit::INTERNAL, format!("where is this program? {error}")))?;
    let mut command = Command::new(program);
    command.args(["--quiet", "bench", "--scaling-row", &case.to_string()]);
    command.args(["--iterations", &arguments.iterations.to_string()]);
    let backend = arguments.backend.unwrap_or(BackendArgument::Cpu);
    if let Some(value) = clap::ValueEnum::to_possible_value(&backend) {
        command.args(["--backend", value.get_name()]);
    }
    let output = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output()?;
    let code = output.status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(exit::INTERNAL);
    if code != 0 {
        return Err(Failure::new(code, format!("the row {case} could not be measured")));
    }
    serde_json::from_slice(&output.stdout).map_err(|error| Failure::new(exit::INTERNAL, error))
}

/// Measures one row and prints it as JSON: what the command starts a process for.
///
/// # Errors
/// Exit 69 without the backend, 78 for a case that cannot be imaged.
pub fn row(case: Case, arguments: &BenchArguments) -> Result<(), Failure> {
    let plan = Arc::new(plan(case).map_err(|error| Failure::new(exit::CONFIG, error))?);
    let prefer = arguments.backend.unwrap_or(BackendArgument::Cpu).into();
    let options = ImagerOptions { threads: None, gpu_deadline_ms: super::DEADLINE_MS };
    let mut imager = Imager::open(Arc::clone(&plan), Arc::new(MaskTable::default()), prefer, options)
        .map_err(|error| backend_failure(&error))?;
    let mut sets: Vec<PingSet> = (0..2).map(|seed| noise(&plan, seed)).collect();
    let mut times_ms = Vec::new();
    for index in 0..arguments.iterations + super::WARM_UP {
        let set = &mut sets[index as usize % 2];
        let start = Instant::now();
        imager.image(set).map_err(|error| backend_failure(&error))?;
        if index >= super::WARM_UP {
            times_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    let times = Quantiles::of(times_ms);
    let report = imager.report();
    let floor = plan.floor(0);
    let raw: usize = (0..case.sensors).map(|sensor| plan.raw_len(sensor) * 4).sum();
    let row = Row {
        case,
        ranges: plan.grid.range_count(),
        backend: report.kind.as_str().to_owned(),
        adapter: report.adapter.clone(),
        threads: report.threads,
        median_ms: times.at(0.5),
        p99_ms: times.at(0.99),
        min_ms: times.at(0.0),
        peak_rss_bytes: super::machine::peak_rss_bytes(),
        raw_bytes: raw as u64,
        image_bytes: (plan.grid.cell_count() * case.sensors * 4) as u64,
        floor_operations: floor.iter().map(|stage| stage.operations).sum(),
        floor_bytes: floor.iter().map(|stage| stage.bytes).sum(),
    };
    print_line(&json!(row).to_string())
}

fn plan(case: Case) -> Result<ImagingPlan, crate::parameter::ParameterError> {
    let recording = RecordingFormat { samples: case.samples, ..RecordingFormat::of(SampleFormat::PcmF32) };
    let emission = EmissionParams::default();
    // A ping hears whole echoes from no farther than this; a little less leaves room for rounding.
    let heard_m = 0.5 * SPEED_OF_SOUND_M_S * (recording.duration_s() - emission.duration_s);
    let range_max_m = RANGE_MAX_M.max(if case.samples > BASE.samples { heard_m } else { 0.0 }).min(0.98 * heard_m);
    let params = ImagingParams { range_max_m, ..ImagingParams::default() };
    let emission = Arc::new(Emission::new(&emission, recording.demodulated_rate_hz(), Path::new(""))?);
    let sensor = |index: usize| SensorSetup {
        name: format!("sensor{index}"),
        mount: Mount { distance_m: 0.0, bearing_rad: index as f64 * 2.0, yaw_rad: 0.0 },
        array: disc(case.microphones),
        emission: Arc::clone(&emission),
        emitter_m: Vector3::zeros(),
    };
    let sensors: Vec<SensorSetup> = (0..case.sensors).map(sensor).collect();
    let hidden = vec![vec![false; case.directions]; case.sensors];
    ImagingPlan::new(&sensors, &hidden, &recording, &params, directions(case), SPEED_OF_SOUND_M_S)
}

/// Microphones in a plane across boresight, in a spiral that fills a disc evenly.
fn disc(count: usize) -> MicrophoneArray {
    let golden_rad = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let position = |index: usize| {
        let radius_m = RADIUS_M * ((index as f64 + 0.5) / BASE.microphones as f64).sqrt();
        let (sin, cos) = (index as f64 * golden_rad).sin_cos();
        Vector3::new(0.0, radius_m * cos, radius_m * sin)
    };
    MicrophoneArray {
        positions_m: (0..count).map(position).collect(),
        enabled: vec![true; count],
        weights: vec![1.0; count],
    }
}

/// A horizontal fan in mirror pairs, or directions evenly over the half sphere ahead.
fn directions(case: Case) -> Vec<Direction> {
    let count = case.directions;
    let share = |index: usize| (index as f64 + 0.5) / count as f64;
    let golden_rad = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let spatial = |index: usize| {
        let (x, turn_rad) = (share(index), index as f64 * golden_rad);
        let across = (1.0 - x * x).sqrt();
        Direction { azimuth_rad: (across * turn_rad.cos()).atan2(x), elevation_rad: (across * turn_rad.sin()).asin() }
    };
    let fan = |index: usize| Direction::horizontal((share(index) - 0.5) * std::f64::consts::PI);
    (0..count).map(|index| if case.spatial { spatial(index) } else { fan(index) }).collect()
}

/// Noise of 1 % of full scale, different for each seed.
fn noise(plan: &ImagingPlan, seed: u32) -> PingSet {
    let lens: Vec<usize> = (0..plan.sensors.len()).map(|sensor| plan.raw_len(sensor)).collect();
    let mut set = PingSet::empty(lens.len(), plan.format, &lens);
    let mut state = seed;
    for (index, ping) in set.pings.iter_mut().enumerate() {
        set.present[index] = true;
        if let Samples::PcmF32(values) = ping.samples_mut() {
            for value in values {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *value = ((state >> 8) as f32 / (1 << 24) as f32 - 0.5) * 0.02;
            }
        }
    }
    set
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_can_be_planned_and_says_what_it_is() {
        for (axis, cases) in axes() {
            for case in cases {
                assert_eq!(case.to_string().parse(), Ok(case));
                let plan = plan(case).expect(axis);
                let shape = (plan.sensors[0].channel_count, plan.grid.direction_count(), plan.sensors.len());
                assert_eq!(shape, (case.microphones, case.directions, case.sensors));
            }
        }
    }

    #[test]
    fn more_microphones_than_a_word_has_bits_are_refused_for_pdm_alone() {
        let mut config = Config::default();
        config.recording.format = SampleFormat::Pdm;
        let mut sensors = config.sensor_setups().expect("built in");
        sensors[0].array = disc(256);
        let hidden = vec![vec![false; 180]; 3];
        let of = |format| {
            let recording = RecordingFormat::of(format);
            ImagingPlan::new(
                &sensors,
                &hidden,
                &recording,
                &ImagingParams::default(),
                directions(BASE),
                SPEED_OF_SOUND_M_S,
            )
        };
        let error = of(SampleFormat::Pdm).expect_err("256 microphones do not fit into 32 bits").to_string();
        assert!(error.contains("256") && error.contains("32"), "{error}");
        of(SampleFormat::PcmF32).expect("PCM has room for 256");
    }
}
