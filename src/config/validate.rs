//! The one validator: every value by itself, then what values must be to each other.
//!
//! Goes in: a [`Config`] and the files it names. Comes out: the first error as a dotted key, or warnings. Changes nothing.

use super::{CONFIG_VERSION, Config, plan, zone};
use crate::imaging::params::{ImagingParams, RANGE_STEP_M, SMOOTHING_MIN_HZ};
use crate::imaging::plan::{clean, combine::Combine};
use crate::parameter::{ParameterError, check_range};
use crate::sensor::{Emission, RecordingFormat, SensorSetup, air};
use crate::signal::{SENSORS_MAX, SampleFormat};
use std::sync::Arc;

/// Bits of a PDM word.
const PDM_CHANNELS_MAX: usize = 32;
/// Most `[[obstruction]]` tables.
const OBSTRUCTIONS_MAX: usize = 64;
/// Most cells of one energyscape: 64 MiB of it.
const CELLS_MAX: f64 = 16_777_216.0;
/// Share of the band that each edge of the matched filter's passband takes.
const PASSBAND_EDGE: f64 = 0.1;

pub(super) fn validate(config: &Config) -> Result<(), ParameterError> {
    if config.config_version != CONFIG_VERSION {
        let allowed = format!("{CONFIG_VERSION}: the only version that this program reads");
        return Err(ParameterError::new("config_version", config.config_version, allowed));
    }
    check_air(config)?;
    let recording = config.recording()?;
    config.emission.validate().map_err(|error| error.within("emission"))?;
    check_sensor_count(config)?;
    for index in 0..config.sensor.len() {
        config.emission_of(index).validate().map_err(|error| config.at_emission(index, error))?;
    }
    let emissions = config.emissions()?;
    for (index, emission) in emissions.iter().enumerate() {
        check_band(config, &recording, index, emission)?;
    }
    config.calibration.validate().map_err(|error| error.within("calibration"))?;
    check_imaging(config, &recording, &emissions)?;
    check_sensors(config, &recording)?;
    config.platform.validate().map_err(|error| error.within("platform"))?;
    config.control.validate().map_err(|error| error.within("control"))?;
    config.ipc.validate().map_err(|error| error.within("ipc"))?;
    config.safety.validate().map_err(|error| error.within("safety"))?;
    plan::check(config, &recording)?;
    config.detect.validate().map_err(|error| error.within("detect"))?;
    zone::check(config)
}

fn check_air(config: &Config) -> Result<(), ParameterError> {
    match (config.speed_of_sound_given_m_s, config.air_temperature_c) {
        (Some(_), Some(temperature_c)) => Err(ParameterError::new(
            "air_temperature_c",
            format!("{temperature_c} beside speed_of_sound_m_s"),
            "one of the two: the speed of sound follows from the temperature",
        )),
        (Some(speed_m_s), None) => check_range("speed_of_sound_m_s", speed_m_s, 200.0, 1600.0),
        (None, Some(temperature_c)) => {
            check_range("air_temperature_c", temperature_c, air::AIR_TEMPERATURE_C.0, air::AIR_TEMPERATURE_C.1)
        }
        (None, None) => Ok(()),
    }
}

/// The sweep and the passband's edges must fit between zero and half the demodulated rate.
fn check_band(
    config: &Config,
    recording: &RecordingFormat,
    index: usize,
    emission: &Emission,
) -> Result<(), ParameterError> {
    let (low_hz, high_hz) = emission.band_hz;
    let params = config.emission_of(index);
    let edge_hz = PASSBAND_EDGE * (high_hz - low_hz);
    let nyquist_hz = 0.5 * recording.demodulated_rate_hz();
    let (low_key, high_key) =
        if params.start_hz < params.end_hz { ("start_hz", "end_hz") } else { ("end_hz", "start_hz") };
    let refuse = |key: &str, found_hz: f64, allowed: String| {
        Err(config.at_emission(index, ParameterError::new(key, found_hz, allowed)))
    };
    if !(high_hz + edge_hz < nyquist_hz) {
        let allowed = format!(
            "a band whose upper edge ({:.0} Hz with the passband's {edge_hz:.0} Hz) lies below {nyquist_hz:.0} Hz, half the \
             demodulated sample rate",
            high_hz + edge_hz
        );
        return refuse(high_key, high_hz, allowed);
    }
    if !(low_hz - edge_hz > 0.0) {
        let allowed = format!(
            "a band whose lower edge ({:.0} Hz with the passband's {edge_hz:.0} Hz) lies above 0 Hz",
            low_hz - edge_hz
        );
        return refuse(low_key, low_hz, allowed);
    }
    Ok(())
}

/// The range step that is fine enough for any echo: the smaller of 5 mm and c / (2.4 bandwidth) of the widest band.
fn fine_step_m(config: &Config, emissions: &[Arc<Emission>]) -> f64 {
    let widest_hz = emissions.iter().map(|emission| emission.band_hz.1 - emission.band_hz.0).fold(0.0, f64::max);
    (config.speed_of_sound_m_s() / (2.4 * widest_hz)).min(5e-3)
}

fn check_imaging(
    config: &Config,
    recording: &RecordingFormat,
    emissions: &[Arc<Emission>],
) -> Result<(), ParameterError> {
    let ImagingParams { range_min_m, range_max_m, range_step_m, smoothing_hz, .. } = config.imaging;
    check_range("imaging.range_min_m", range_min_m, 0.0, 100.0)?;
    if !(range_max_m > range_min_m) {
        let allowed = format!("a range above range_min_m, {range_min_m}");
        return Err(ParameterError::new("imaging.range_max_m", range_max_m, allowed));
    }
    let longest_s = emissions.iter().map(|emission| emission.duration_s()).fold(0.0, f64::max);
    let heard_s = recording.duration_s() - longest_s;
    let reach_m = 0.5 * config.speed_of_sound_m_s() * heard_s;
    if !(range_max_m <= reach_m) {
        let allowed = format!(
            "at most {:.3} m: a ping of {:.2} ms hears whole echoes of {:.2} ms from no farther",
            reach_m.max(0.0),
            1e3 * recording.duration_s(),
            1e3 * longest_s
        );
        return Err(ParameterError::new("imaging.range_max_m", range_max_m, allowed));
    }
    if let Some(step_m) = range_step_m {
        check_range("imaging.range_step_m", step_m, *RANGE_STEP_M.start(), *RANGE_STEP_M.end())?;
        if !(step_m <= range_max_m - range_min_m) {
            let allowed = format!("at most {:.3} m, the whole of the ranges", range_max_m - range_min_m);
            return Err(ParameterError::new("imaging.range_step_m", step_m, allowed));
        }
    }
    if let Some(cutoff_hz) = smoothing_hz {
        check_range("imaging.smoothing_hz", cutoff_hz, SMOOTHING_MIN_HZ, 0.5 * recording.demodulated_rate_hz())?;
    }
    clean::rounds(&config.imaging, Combine::new(&config.imaging)?.is_sum())?;
    let direction_count = config.directions()?.len() as f64;
    let range_count = (range_max_m - range_min_m) / range_step_m.unwrap_or_else(|| fine_step_m(config, emissions));
    if !(direction_count * range_count <= CELLS_MAX) {
        let found = format!("{direction_count} directions by {range_count:.0} ranges");
        return Err(ParameterError::new("imaging", found, format!("at most {CELLS_MAX} cells")));
    }
    Ok(())
}

fn check_sensor_count(config: &Config) -> Result<(), ParameterError> {
    if !(1..=SENSORS_MAX).contains(&config.sensor.len()) {
        let found = format!("{} sensors", config.sensor.len());
        let key = if config.sensor.is_empty() { "sensor".to_owned() } else { format!("sensor[{SENSORS_MAX}]") };
        return Err(ParameterError::new(key, found, format!("1 to {SENSORS_MAX} sensors")));
    }
    Ok(())
}

fn check_sensors(config: &Config, recording: &RecordingFormat) -> Result<(), ParameterError> {
    let setups = config.sensor_setups()?;
    for (index, sensor) in setups.iter().enumerate() {
        if let Some(first) = setups[..index].iter().position(|earlier| earlier.name == sensor.name) {
            let found = format!("{:?}, the name of sensor[{first}]", sensor.name);
            return Err(ParameterError::new(format!("sensor[{index}].name"), found, "a name of its own"));
        }
        let channels = sensor.array.channel_count();
        if recording.format == SampleFormat::Pdm && channels > PDM_CHANNELS_MAX {
            let allowed = format!("at most {PDM_CHANNELS_MAX} with recording.format = \"pdm\": a bit a microphone");
            return Err(ParameterError::new(
                format!("sensor[{index}].array"),
                format!("{channels} microphones"),
                allowed,
            ));
        }
    }
    check_obstructions(config, &setups)
}

fn check_obstructions(config: &Config, setups: &[SensorSetup]) -> Result<(), ParameterError> {
    if config.obstruction.len() > OBSTRUCTIONS_MAX {
        let found = format!("{} obstructions", config.obstruction.len());
        return Err(ParameterError::new("obstruction", found, format!("at most {OBSTRUCTIONS_MAX}")));
    }
    for (index, shape) in config.obstruction.iter().enumerate() {
        let key = format!("obstruction[{index}]");
        shape.validate(&key)?;
        if let Some(blind) = setups.iter().find(|sensor| shape.contains(sensor.mount.position_m())) {
            let found = format!("a shape around the origin of sensor {:?}, which would see nothing", blind.name);
            return Err(ParameterError::new(key, found, "a shape beside the sensors"));
        }
    }
    let directions = config.directions()?;
    for (index, zone) in config.dead_zones(setups, &directions).iter().enumerate() {
        if zone.hidden_count() == directions.len() {
            let found = format!("a sensor with all its directions hidden ({})", zone.listed.join("; "));
            return Err(ParameterError::new(format!("sensor[{index}]"), found, "a sensor that sees something"));
        }
    }
    Ok(())
}

pub(super) fn warnings(config: &Config) -> Vec<String> {
    let mut warnings = zone::warnings(config);
    let (Ok(recording), Ok(emissions)) = (config.recording(), config.emissions()) else { return warnings };
    let fine_m = fine_step_m(config, &emissions);
    if let Some(step_m) = config.imaging.range_step_m.filter(|step_m| !(*step_m <= fine_m)) {
        warnings.push(format!(
            "imaging.range_step_m = {step_m} is coarser than {fine_m:.4}: an echo's peak can fall between two bins and read \
             several dB low"
        ));
    }
    let period_s = 1.0 / config.control.rate_hz;
    if !(recording.duration_s() <= period_s) {
        warnings.push(format!(
            "a ping lasts {:.1} ms and control.rate_hz = {} asks for one every {:.1} ms",
            1e3 * recording.duration_s(),
            config.control.rate_hz,
            1e3 * period_s
        ));
    }
    warnings.extend(plan::warnings(config, &recording));
    warnings.extend(uncalibrated(config));
    if let (Ok(setups), Ok(directions)) = (config.sensor_setups(), config.directions()) {
        warnings.extend(config.dead_zones(&setups, &directions).into_iter().flat_map(|zone| zone.warnings));
    }
    warnings
}

/// Standard deviation of a calibrated speed of sound, as a share, from which it may be worse than the configured one: 3 K.
const SPEED_SD_SHARE: f64 = 0.005;

/// Sensors that a calibration which is to be applied does not know, and a speed of sound that it hardly knows.
fn uncalibrated(config: &Config) -> Vec<String> {
    let params = &config.calibration;
    let Some(measured) = params.measured.as_ref().filter(|_| !params.apply.is_empty()) else { return Vec::new() };
    let mut warnings = Vec::new();
    let names = config.sensor.iter().map(|sensor| sensor.name.as_str());
    let unknown: Vec<&str> = names.filter(|name| measured.sensor(name).is_none()).collect();
    if !unknown.is_empty() {
        warnings.push(format!("calibration.file knows nothing of sensor {}: used as configured", unknown.join(", ")));
    }
    let best_m_s = measured.sensor.iter().map(|sensor| sensor.speed_of_sound_sd_m_s).fold(f64::INFINITY, f64::min);
    if params.speed_of_sound_m_s().is_some_and(|speed_m_s| !(best_m_s <= SPEED_SD_SHARE * speed_m_s)) {
        warnings.push(format!(
            "calibration.apply lists \"speed-of-sound\", which the file knows to {best_m_s:.1} m/s only: calibrate with \
             --air-temperature-c"
        ));
    }
    warnings
}
