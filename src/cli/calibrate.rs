//! `noctule calibrate`: recordings to a file of what was measured of the sensors.
//!
//! Every sensor is measured against the configuration as it stands, whatever calibration that names. A sensor that cannot be measured,
//! or that says something implausible, is an error that names it; then nothing is written.

use super::args::CalibrateArguments;
use super::output::{NewFile, print_line};
use super::process::{data_failure, find_sensor};
use super::{Failure, exit};
use crate::calibration::arrival::Sweep;
use crate::calibration::cross::{HEARD_MIN, hearing, measure_cross, with_pairs};
use crate::calibration::file::{CALIBRATION_VERSION, utc};
use crate::calibration::{Calibration, CrossCalibration, Observer, SensorCalibration, Tolerances, measure};
use crate::config::Config;
use crate::io::record::{Entry, RunReader};
use crate::io::recording_file::{RecordingFile, RecordingShape, is_mcap};
use crate::sensor::{RecordingFormat, SensorSetup, air};
use crate::service::wiring::{self, SensingSetup};
use crate::signal::Samples;
use serde_json::json;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::UNIX_EPOCH;

/// Standard deviation of a thermometer, kelvins.
const THERMOMETER_SD_K: f64 = 0.5;
/// Channels heard in a ping: all.
const ALL: usize = usize::MAX;

/// Runs the command.
///
/// # Errors
/// Exit 65 for a recording that is of no use or tells something implausible, 73, 74, 77, 78.
pub fn calibrate(arguments: &CalibrateArguments) -> Result<(), Failure> {
    let first = arguments.inputs.iter().find(|path| is_mcap(path)).unwrap_or(&arguments.inputs[0]);
    let config = super::record::config_of_recording(first, &arguments.choice)?.uncalibrated();
    let chosen = find_sensor(&config, arguments.sensor.as_deref())?;
    let all = arguments.sensor.is_none() && arguments.inputs.iter().all(|path| is_mcap(path));
    let sensors: Vec<usize> = if all { (0..config.sensor.len()).collect() } else { vec![chosen] };
    let mut listeners = Vec::new();
    for index in sensors {
        listeners.push(Listener::of_all(&config, index, &arguments.inputs)?);
    }
    let (known, tolerances) = knowledge(&config, arguments);
    let mount_sd_m = 1e-3 * arguments.mount_sd_mm;
    let cross: Vec<CrossCalibration> =
        listeners.iter().flat_map(|listener| listener.cross(known.0, (&tolerances, mount_sd_m))).collect();
    // Sensors that hear each other know the air better: as a thermometer does.
    let (speed_m_s, speed_sd_m_s) = with_pairs(known, &cross);
    let tolerances = Tolerances { speed_m_s: speed_sd_m_s, ..tolerances };
    let measured = listeners.iter().map(|listener| listener.measure(speed_m_s, &tolerances));
    let recorded = arguments.inputs.iter().filter_map(|path| recorded_s(path)).max();
    let calibration = Calibration {
        calibration_version: CALIBRATION_VERSION,
        recorded: recorded.map_or_else(String::new, utc),
        sensor: measured.collect::<Result<_, _>>()?,
        cross,
    };
    calibration.validate().map_err(|error| {
        let message = format!("what was measured is implausible, nothing was written: {error}");
        Failure::new(exit::DATA, message)
    })?;
    let mut file = NewFile::create(&arguments.out)?;
    file.write_all(calibration.to_toml().as_bytes()).map_err(|error| file.failure(&error))?;
    file.finish()?;
    if arguments.json {
        return print_line(&json!(calibration).to_string());
    }
    calibration.cross.iter().try_for_each(tell_pair)?;
    calibration.sensor.iter().try_for_each(tell)
}

/// When a recording was made, in seconds since 1970: by the stamp of its first ping, or where it has none by the file's last change.
fn recorded_s(path: &Path) -> Option<u64> {
    let stamped = || {
        let mut reader = RunReader::open(path).ok()?;
        loop {
            if let Entry::Raw(_, ping) = reader.next_entry().ok()?? {
                return Some(ping.wire.t_wall_ns / 1_000_000_000);
            }
        }
    };
    is_mcap(path).then(stamped).flatten().or_else(|| modified_s(path))
}

fn modified_s(path: &Path) -> Option<u64> {
    let modified = std::fs::metadata(path).and_then(|metadata| metadata.modified()).ok()?;
    Some(modified.duration_since(UNIX_EPOCH).ok()?.as_secs())
}

/// Speed of sound and how well it is known, and how well everything is.
fn knowledge(config: &Config, arguments: &CalibrateArguments) -> ((f64, f64), Tolerances) {
    let tolerances = Tolerances {
        emitter_m: 1e-3 * arguments.emitter_sd_mm,
        place_m: 1e-3 * arguments.place_sd_mm,
        late_s: 1e-6 * arguments.late_sd_us,
        ..Tolerances::default()
    };
    let known = match arguments.air_temperature_c.map(air::speed_of_sound_m_s) {
        Some(speed_m_s) => (speed_m_s, THERMOMETER_SD_K / air::kelvins_per_m_s(speed_m_s)),
        None => (config.speed_of_sound_m_s(), tolerances.speed_m_s),
    };
    (known, tolerances)
}

/// One sensor, and what it heard of itself and of the others.
struct Listener {
    name: String,
    setup: SensingSetup,
    own: Observer,
    others: Vec<(SensorSetup, Observer)>,
}

impl Listener {
    /// Listens to all pings of all recordings.
    fn of_all(config: &Config, index: usize, inputs: &[PathBuf]) -> Result<Self, Failure> {
        let mut listener: Option<Self> = None;
        for input in inputs {
            let mut recording = RecordingFile::open_sensor(input, wiring::file_hints(config), index)
                .map_err(|error| data_failure(&error))?;
            let format = format_of(config, input, recording.shape())?;
            let listener = match &mut listener {
                Some(listener) if listener.setup.recording != format => {
                    let alike = "recordings that are alike".to_owned();
                    return Err(bad(input, "pings of another format or length".to_owned(), alike));
                }
                Some(listener) => listener,
                None => listener.insert(Self::new(config, index, &format)?),
            };
            let channels = listener.setup.plan.sensors[0].channel_count;
            if let Some(found) = recording.shape().channel_count.filter(|found| *found != channels) {
                let allowed = format!("{channels}, as the array of sensor {} has", listener.name);
                return Err(bad(input, format!("{found} microphones"), allowed));
            }
            let mut samples = Samples::zeros(format.format, 0);
            while recording.read_ping(&mut samples).map_err(|error| data_failure(&error))? {
                listener.own.listen(&listener.setup.plan, &samples);
                for (_, observer) in &mut listener.others {
                    observer.listen(&listener.setup.plan, &samples);
                }
            }
        }
        listener.ok_or_else(|| Failure::new(exit::USAGE, "no recording"))
    }

    fn new(config: &Config, index: usize, format: &RecordingFormat) -> Result<Self, Failure> {
        let refuse = |error| Failure::new(exit::CONFIG, error);
        let setup = wiring::sensing_of_one(config, index, format).map_err(refuse)?;
        let sensor = &setup.sensors[0];
        let speed_m_s = setup.speed_of_sound_m_s;
        let observe = |sensor: &SensorSetup| {
            let sweep = Arc::new(Sweep::new(&sensor.emission));
            Observer::new(&setup.plan, sensor, &sweep, speed_m_s, (ALL, f64::INFINITY), None)
        };
        let all = config.sensor_setups().map_err(refuse)?;
        let others = all.into_iter().enumerate().filter(|(other, _)| *other != index);
        let others = others.map(|(_, other)| {
            let observer = observe(&hearing(sensor, &other)).clear_from(HEARD_MIN);
            (other, observer)
        });
        let (own, others, name) = (observe(sensor), others.collect(), sensor.name.clone());
        Ok(Self { name, own, others, setup })
    }

    fn cross(&self, speed_m_s: f64, known: (&Tolerances, f64)) -> Vec<CrossCalibration> {
        let listener = &self.setup.sensors[0];
        let pairs = self.others.iter();
        pairs.filter_map(|(other, observer)| measure_cross(observer, (listener, other), speed_m_s, known)).collect()
    }

    fn measure(&self, speed_m_s: f64, tolerances: &Tolerances) -> Result<SensorCalibration, Failure> {
        let sensor = &self.setup.sensors[0];
        let found = measure(&self.own, sensor, speed_m_s, tolerances).ok_or_else(|| {
            let (name, pings) = (&self.name, self.own.pings());
            let message = format!(
                "sensor {name}: found too few microphones that hear the emission in {pings} pings, allowed: at least 6, and 3 pings"
            );
            Failure::new(exit::DATA, message)
        })?;
        found.check_fits(sensor).map_err(|error| {
            let message = format!("nothing was written: found {}, allowed: {}", error.found, error.allowed);
            Failure::new(exit::DATA, message)
        })?;
        Ok(found)
    }
}

fn bad(input: &Path, found: String, allowed: String) -> Failure {
    Failure::new(exit::DATA, format!("{}: found {found}, allowed: {allowed}", input.display()))
}

fn format_of(config: &Config, input: &Path, shape: RecordingShape) -> Result<RecordingFormat, Failure> {
    wiring::recording_for(config, shape.format, shape.sample_count)
        .map_err(|error| bad(input, error.found, format!("{} (recording.{})", error.allowed, error.key)))
}

/// Prints what a pair of sensors told.
fn tell_pair(pair: &CrossCalibration) -> Result<(), Failure> {
    print_line(&format!(
        "{} hears {}: sound {:.2} +- {:.2} m/s, by {} microphones to {:.3} mm rms",
        pair.to,
        pair.from,
        pair.speed_of_sound_m_s,
        pair.speed_of_sound_sd_m_s,
        pair.microphones,
        1e3 * pair.residual_m
    ))
}

/// Prints what was measured of a sensor.
fn tell(found: &SensorCalibration) -> Result<(), Failure> {
    let [x_mm, y_mm, z_mm] = found.emitter_m.map(|place_m| 1e3 * place_m);
    let [x_sd, y_sd, z_sd] = found.emitter_sd_m.map(|sd_m| 1e3 * sd_m);
    let most = |values: &[f64]| {
        let largest = values.iter().enumerate().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
        largest.map_or((0, 0.0), |(index, value)| (index, *value))
    };
    let (path, gain) = (most(&found.path_m), most(&found.gain_db));
    let list = |name: &str, list: &[usize]| {
        if list.is_empty() { String::new() } else { format!("\n  {name}: {list:?}") }
    };
    let blind = if found.not_observable.is_empty() {
        String::new()
    } else {
        format!("\n  not observable, as configured: {}", found.not_observable.join(", "))
    };
    print_line(&format!(
        "{}: {} pings\n  sound {:.2} +- {:.2} m/s, air {:.1} +- {:.1} C\n  emitter ({x_mm:.2}, {y_mm:.2}, {z_mm:.2}) +- ({x_sd:.2}, \
         {y_sd:.2}, {z_sd:.2}) mm, {:.2} +- {:.2} us late, level {:.1} dB at 1 m\n  microphones {:.3} mm rms, most {:+.3} mm \
         (microphone {}); gains most {:+.2} dB (microphone {}){}{}{}{blind}",
        found.name,
        found.pings,
        found.speed_of_sound_m_s,
        found.speed_of_sound_sd_m_s,
        found.air_temperature_c,
        found.air_temperature_sd_c,
        found.late_us,
        found.late_sd_us,
        found.level_db,
        1e3 * found.residual_m,
        1e3 * path.1,
        path.0,
        gain.1,
        gain.0,
        list("not heard", &found.unheard),
        list("misplaced", &found.misplaced),
        list("cut off at full scale, gain unknown", &found.clipped),
    ))
}
