//! A daemon's topics with pings whose strongest cell is known, and what a client printed held against them.
#![allow(dead_code, reason = "every test file uses another part")]

use crate::ipc_rig::Place;
use noctule::io::DaemonTopics;
use noctule::io::topics::topics_json;
use noctule::io::wire::message::EnergyscapeHeader;
use noctule::signal::{Direction, PolarGrid, SampleFormat};
use noctule::time::{Clock, SystemClock};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// What the daemon's sensors are called without a configuration.
pub const SENSORS: [&str; 3] = ["front", "left", "right"];
pub const DIRECTIONS: usize = 45;
pub const RANGES: usize = 320;
/// Emission of a published ping, before the moment of publishing.
pub const EMITTED_BEFORE_MS: f64 = 70.0;
/// Starting Python with numpy and matplotlib takes 1 to 4 s on a loaded machine; nothing here may take longer than this.
pub const CLIENT_LIMIT: Duration = Duration::from_secs(60);

/// Whether Python and its packages are here. Without them tests end early, and say so past the test runner's capture.
pub fn python_is_missing() -> bool {
    static MISSING: OnceLock<Option<String>> = OnceLock::new();
    let missing = MISSING.get_or_init(|| {
        let imports =
            "import iceoryx2, numpy, matplotlib, importlib.metadata as m; assert m.version('iceoryx2') == '0.10.0'";
        match Command::new("python3").args(["-c", imports]).output() {
            Err(error) => Some(format!("python3: {error}")),
            Ok(output) if output.status.success() => None,
            Ok(output) => Some(last_line(&output.stderr)),
        }
    });
    let Some(why) = missing else { return false };
    let help = "pip install 'iceoryx2==0.10.0' numpy matplotlib";
    assert!(std::env::var_os("NOCTULE_REQUIRE_PYTHON").is_none_or(|value| value != "1"), "{why}; {help}");
    let _ = writeln!(std::io::stderr(), "SKIPPED, the Python client is NOT tested: {why}; {help}");
    true
}

pub fn last_line(text: &[u8]) -> String {
    String::from_utf8_lossy(text).trim().lines().last().unwrap_or("").to_owned()
}

/// One published ping.
#[derive(Debug, Clone, Copy)]
pub struct Published {
    pub range_m: f64,
    pub bearing_deg: f64,
    pub value: f32,
    pub t_monotonic_ns: u64,
}

/// A daemon's topics, and what was published on those of the second sensor.
pub struct Publisher {
    pub topics: DaemonTopics,
    pub grid: PolarGrid,
    pub published: BTreeMap<u64, Published>,
    pub sequence: u64,
    pub place: Place,
}

impl Publisher {
    pub fn new() -> Self {
        let directions = (0..DIRECTIONS).map(|index| Direction::horizontal((-88.0 + 4.0 * index as f64).to_radians()));
        let grid = PolarGrid::new(directions.collect(), 0.4, 0.0125, RANGES);
        let place = Place::new();
        let names = SENSORS.map(str::to_owned);
        let topics = DaemonTopics::open(&place.ipc, &names, &[grid.cell_count(); 3]).expect("opened");
        Self { topics, grid, published: BTreeMap::new(), sequence: 1 << 40, place }
    }

    /// Publishes on the sensor `sensor_index` a faint pattern with one strong cell.
    pub fn publish_peak(&mut self, sensor_index: usize, direction: usize, column: usize, value: f32) {
        let now = SystemClock.now();
        let t_monotonic_ns = now.boottime_ns - (EMITTED_BEFORE_MS * 1e6) as u64;
        let mut values: Vec<f32> = (0..self.grid.cell_count()).map(|cell| 1e-3 * (cell % 7) as f32).collect();
        values[self.grid.cell(direction, column)] = value;
        let header = EnergyscapeHeader {
            sequence: self.sequence,
            t_monotonic_ns,
            t_wall_ns: now.wall_ns,
            t_completed_ns: now.boottime_ns,
            ..EnergyscapeHeader::for_grid(&self.grid, sensor_index, 343.0)
        };
        self.topics.publish_energyscape(sensor_index, &header, &values).expect("published");
        // Written out, not taken from the grid, which made the header.
        let range_m = 0.4 + 0.0125 * column as f64;
        let bearing_deg = -88.0 + 4.0 * direction as f64;
        self.published.insert(self.sequence, Published { range_m, bearing_deg, value, t_monotonic_ns });
    }

    /// The next ping set: the second sensor's peak wanders, the others' stays elsewhere. Every fifth number is left out.
    pub fn publish_next(&mut self) {
        self.sequence += if self.sequence % 5 == 3 { 2 } else { 1 };
        let step = self.sequence as usize;
        for other in [0, 2] {
            self.publish_peak(other, 1, 2, 0.5);
        }
        self.publish_peak(1, (7 * step) % DIRECTIONS, (31 * step) % RANGES, 0.25 + (step % 100) as f32 * 1e-3);
    }

    pub fn topics_json(&self) -> Value {
        topics_json(&self.place.params, &SENSORS.map(str::to_owned), SampleFormat::PcmI16)
    }

    pub fn topics_file(&self, topics: &Value) -> PathBuf {
        let path = self.place.directory.path().join("topics.json");
        std::fs::write(&path, topics.to_string()).expect("written");
        path
    }
}

/// Runs a command, calling `meanwhile` every 40 ms. Fails when it does not end in time.
pub fn run(command: &mut Command, mut meanwhile: impl FnMut()) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("started");
    let deadline = Instant::now() + CLIENT_LIMIT;
    while child.try_wait().expect("a child").is_none() {
        if Instant::now() > deadline {
            let _ = child.kill();
            panic!("not ended after {CLIENT_LIMIT:?}: {:?}", child.wait_with_output());
        }
        meanwhile();
        std::thread::sleep(Duration::from_millis(40));
    }
    child.wait_with_output().expect("output")
}

pub fn stdout(output: &Output) -> &str {
    assert!(output.status.success(), "{output:?}");
    std::str::from_utf8(&output.stdout).expect("UTF-8")
}

/// What is wrong with the lines of `--print`, compared with what was published; the number of pings if nothing is.
pub fn compare(text: &str, published: &BTreeMap<u64, Published>) -> Result<usize, String> {
    let mut before: Option<u64> = None;
    for line in text.lines() {
        let pairs: BTreeMap<&str, &str> = line.split(' ').filter_map(|pair| pair.split_once('=')).collect();
        let number = |name: &str| pairs[name].parse::<f64>().expect("a number");
        let sequence: u64 = pairs["sequence"].parse().expect("an integer");
        let expected = published.get(&sequence).ok_or(format!("never published: {line}"))?;
        // Half a unit of the last digit printed.
        let close = (number("range_m") - expected.range_m).abs() <= 0.51e-4
            && (number("bearing_deg") - expected.bearing_deg).abs() <= 0.51e-3
            && (number("value") / f64::from(expected.value) - 1.0).abs() <= 1e-5
            && pairs["t_monotonic_ns"].parse() == Ok(expected.t_monotonic_ns)
            && (EMITTED_BEFORE_MS..CLIENT_LIMIT.as_secs_f64() * 1e3).contains(&number("age_ms"));
        let lost = before.map_or(Some(0), |before| sequence.checked_sub(before + 1));
        if !close || pairs["lost"].parse().ok() != lost {
            return Err(format!("{line}, after {before:?}, but {expected:?}"));
        }
        before = Some(sequence);
    }
    Ok(text.lines().count())
}
