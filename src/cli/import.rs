//! `noctule config import`: the JSON settings of RTIS Dev (Cosys-Lab's Python library for eRTIS sensors) as a configuration.
//!
//! In: files of recording settings, processing settings, or both; the keys are those that the library documents for its `jsonPath`
//! arguments, and those arguments that its users put beside them. Out: TOML; every key without a counterpart stands there as a
//! comment that says why. Nothing is guessed: what is not known is said.

use super::args::ImportArguments;
use super::output::{NewFile, print_line};
use super::{Failure, exit};
use crate::config::Config;
use serde_json::{Map, Value};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Largest file of settings.
const SIZE_MAX_BYTES: u64 = 1 << 20;
/// What the library takes where its processing settings say nothing: directions, azimuths.
const DIRECTIONS_DEFAULT: f64 = 181.0;
const AZIMUTHS_DEFAULT_DEG: (f64, f64) = (-90.0, 90.0);

/// Imports settings.
///
/// # Errors
/// 65 for a file that is no settings, 73 for a result that is there already or cannot be made, 78 when the result is written and
/// refused as a configuration.
pub fn import(arguments: &ImportArguments) -> Result<(), Failure> {
    let mut settings = Map::new();
    for path in &arguments.settings {
        let text =
            crate::document::read_at_most(path, SIZE_MAX_BYTES).map_err(|error| Failure::new(exit::DATA, error))?;
        let refuse = |found: String| {
            Failure::new(exit::DATA, format!("{}: found {found}, allowed: one JSON object of settings", path.display()))
        };
        match serde_json::from_str(&text) {
            Ok(Value::Object(object)) => settings.extend(object),
            Ok(_) => return Err(refuse("another kind of JSON".to_owned())),
            Err(error) => return Err(refuse(format!("no JSON: {error}"))),
        }
    }
    let names: Vec<String> = arguments.settings.iter().map(|path| path.display().to_string()).collect();
    let text = translate(&settings, &names.join(", "));
    match &arguments.out {
        None => print_line(text.trim_end())?,
        Some(path) if path.exists() => {
            let message =
                format!("{}: found a file, allowed: a new one; remove it or choose another name", path.display());
            return Err(Failure::new(exit::CANNOT_CREATE, message));
        }
        Some(path) => {
            let mut file = NewFile::create(path)?;
            file.write_all(text.as_bytes()).map_err(|error| file.failure(&error))?;
            file.finish()?;
        }
    }
    let place = arguments.out.as_deref().unwrap_or(Path::new("imported.toml"));
    match Config::parse(&text, place) {
        Ok(_) => Ok(()),
        Err(error) => {
            Err(Failure::new(exit::CONFIG, format!("imported, and to be corrected before it can be used: {error}")))
        }
    }
}

/// Sections of the result, each with its lines.
#[derive(Default)]
struct Translated {
    recording: Vec<String>,
    emission: Vec<String>,
    imaging: Vec<String>,
    sensor: Vec<String>,
    left_over: Vec<String>,
}

impl Translated {
    /// A key that has no counterpart, and why.
    fn left(&mut self, key: &str, value: &Value, why: &str) {
        self.left_over.push(format!("# {key} = {value}: {why}"));
    }

    fn text(&self, from: &str) -> String {
        let mut text = format!("# Imported from {from} (RTIS Dev settings).\nconfig_version = 1\n");
        let sections = [
            ("[recording]", &self.recording),
            ("[emission]", &self.emission),
            ("[imaging]", &self.imaging),
            ("[[sensor]]", &self.sensor),
        ];
        if !self.left_over.is_empty() {
            let _ = writeln!(text, "\n# Without a counterpart here:\n{}", self.left_over.join("\n"));
        }
        for (heading, lines) in sections.iter().filter(|(_, lines)| !lines.is_empty()) {
            let _ = writeln!(text, "\n{heading}\n{}", lines.join("\n"));
        }
        text
    }
}

/// A number of the settings, taken out; what is no number is left over with a word about it.
fn number(settings: &mut Map<String, Value>, key: &str, result: &mut Translated) -> Option<f64> {
    let value = settings.remove(key)?;
    let found = value.as_f64().filter(|number| number.is_finite());
    if found.is_none() {
        result.left(key, &value, "no number");
    }
    found
}

fn translate(settings: &Map<String, Value>, from: &str) -> String {
    let mut settings = settings.clone();
    let mut result = Translated::default();
    recording(&mut settings, &mut result);
    emission(&mut settings, &mut result);
    imaging(&mut settings, &mut result);
    sensor(&mut settings, &mut result);
    for (key, value) in &settings {
        result.left(key, value, why(key, value));
    }
    result.text(from)
}

fn recording(settings: &mut Map<String, Value>, result: &mut Translated) {
    let pdm = settings.remove("pdmEnable");
    if pdm == Some(Value::Bool(false)) {
        result.left(
            "pdmEnable",
            &Value::Bool(false),
            "then the data are no PDM: set recording.format to what they are",
        );
    }
    let samples = number(settings, "microphoneSamples", result);
    let rate_hz = number(settings, "microphoneSampleFrequency", result);
    let call_rate_hz = number(settings, "callSampleFrequency", result);
    if samples.is_none() && rate_hz.is_none() && call_rate_hz.is_none() {
        return;
    }
    result.recording.push("format = \"pdm\"".to_owned());
    if let Some(rate_hz) = rate_hz {
        result.recording.push(format!("sample_rate_hz = {rate_hz:?}  # microphoneSampleFrequency"));
    }
    if let Some(samples) = samples {
        result.recording.push(format!("samples = {samples}  # microphoneSamples"));
    }
    if let Some((rate_hz, call_rate_hz)) = rate_hz.zip(call_rate_hz) {
        let decimation = rate_hz / call_rate_hz;
        if decimation >= 1.0 && decimation.fract() == 0.0 {
            let line = format!("decimation = {decimation}  # microphoneSampleFrequency / callSampleFrequency");
            result.recording.push(line);
            return;
        }
    }
    if let Some(call_rate_hz) = call_rate_hz {
        let why = "no whole part of microphoneSampleFrequency: recording.decimation stays 10";
        result.left("callSampleFrequency", &Value::from(call_rate_hz), why);
    }
}

fn emission(settings: &mut Map<String, Value>, result: &mut Translated) {
    let low_hz = number(settings, "callMinimumFrequency", result);
    let high_hz = number(settings, "callMaximumFrequency", result);
    let duration_ms = number(settings, "callDuration", result);
    if let Some(custom) = settings.remove("callCustom").filter(|custom| !custom.is_null()) {
        result.left(
            "callCustom",
            &custom,
            "write its samples at the demodulated rate as rows index,sample, then shape = \"csv\", file, and the band as start_hz, end_hz",
        );
    }
    if let Some(high_hz) = high_hz {
        result.emission.push(format!("start_hz = {high_hz:?}  # callMaximumFrequency: the call sweeps downwards"));
    }
    if let Some(low_hz) = low_hz {
        result.emission.push(format!("end_hz = {low_hz:?}  # callMinimumFrequency"));
    }
    if let Some(duration_ms) = duration_ms {
        result.emission.push(format!("duration_s = {:?}  # callDuration, there in milliseconds", duration_ms * 1e-3));
    }
}

fn imaging(settings: &mut Map<String, Value>, result: &mut Translated) {
    for (key, ours) in [("minRange", "range_min_m"), ("maxRange", "range_max_m")] {
        if let Some(range_m) = number(settings, key, result) {
            result.imaging.push(format!("{ours} = {range_m:?}  # {key}"));
        }
    }
    let asked = ["directions", "azimuthLowLimit", "azimuthHighLimit"].iter().any(|key| settings.contains_key(*key));
    let flat = |value: Option<&Value>| value.is_none_or(|value| *value == 1 || *value == true);
    let horizontal = flat(settings.get("2D")) && flat(settings.get("mode"));
    let count = number(settings, "directions", result);
    let low_deg = number(settings, "azimuthLowLimit", result);
    let high_deg = number(settings, "azimuthHighLimit", result);
    if horizontal {
        settings.remove("2D");
        settings.remove("mode");
    }
    if !asked {
        return;
    }
    if !horizontal {
        let count = count.map_or(Value::Null, Value::from);
        result.left(
            "directions",
            &count,
            "a half sphere of directions: write them to a CSV, imaging.directions = { file }",
        );
        return;
    }
    let count = count.unwrap_or(DIRECTIONS_DEFAULT);
    let (low_deg, high_deg) = (low_deg.unwrap_or(AZIMUTHS_DEFAULT_DEG.0), high_deg.unwrap_or(AZIMUTHS_DEFAULT_DEG.1));
    let step_deg = if count > 1.0 { (high_deg - low_deg) / (count - 1.0) } else { 1.0 };
    result.imaging.push(format!(
        "directions = {{ start_deg = {low_deg:?}, step_deg = {step_deg:?}, count = {count} }}  # directions, azimuthLowLimit, azimuthHighLimit"
    ));
}

fn sensor(settings: &mut Map<String, Value>, result: &mut Translated) {
    match settings.remove("microphoneLayout") {
        None => {}
        Some(Value::String(layout)) if layout.eq_ignore_ascii_case("eRTIS_v3D1") => {
            result.sensor.push("name = \"front\"".to_owned());
            result.sensor.push(format!("array = \"ertis-v3d1\"  # microphoneLayout = {layout}"));
        }
        Some(layout) => {
            let why = "another array: write its microphones as mic,x_m,y_m,z_m to a CSV and name it in sensor.array";
            result.left("microphoneLayout", &layout, why);
        }
    }
}

/// Why a key has no counterpart.
fn why(key: &str, value: &Value) -> &'static str {
    let off = matches!(value, Value::Bool(false) | Value::Null) || *value == 0;
    match key {
        "matchedFilterEnable" | "beamformingEnable" | "enveloppeEnable" if !off => "as here, where it is always done",
        "matchedFilterEnable" | "beamformingEnable" | "enveloppeEnable" => {
            "here it is always done; `noctule plot` shows what comes before"
        }
        "callEmissions" if *value == 1 => "as here",
        "callEmissions" => "a ping here has one emission",
        "cleanEnable" | "preFilterEnable" | "postFilterEnable" | "cfEnable" | "preFilter" | "postFilter" if off => {
            "off, as here"
        }
        "cleanEnable" | "meanEnergyRangeMultiplier" | "maxEnergyRangeThresholdMultiplier" => {
            "the image is not cleaned here: control.energy has a noise floor and a side-lobe rule instead"
        }
        "preFilterEnable" | "postFilterEnable" | "preFilter" | "postFilter" => {
            "the matched filter's passband is the only filter; imaging.smoothing_hz smooths the envelope"
        }
        "dmasOrder" if off || *value == 1 => "delay and sum, as here",
        "dmasOrder" => "only delay and sum is done here",
        "cfEnable" => "no coherence factor here; imaging.weighting = \"phat\" is the nearest",
        "elevation2DAngle" if off || value.as_f64() == Some(0.0) => "horizontal, as here",
        "elevation2DAngle" | "elevationLowLimit" | "elevationHighLimit" | "2D" | "mode" => {
            "directions with elevations are written to a CSV: imaging.directions = { file }"
        }
        "directionsCustom" | "customPath" => {
            "write azimuth_deg,elevation_deg rows to a CSV: imaging.directions = { file }; RTIS Dev's own unit is not documented"
        }
        "delayMatrixCustom" | "rangesCustom" => "follows here from array, directions and ranges",
        "premade" => {
            "a name of RTIS Dev's own settings: import the JSON file of that name from its folder premadeSettings"
        }
        "preloadToggle" | "configName" | "applyToDevice" | "jsonPath" => "of the library, not of the data",
        _ => "unknown",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn imported(settings: Value) -> (String, Config) {
        let Value::Object(settings) = settings else { panic!("an object") };
        let text = translate(&settings, "settings.json");
        let config = Config::parse(&text, Path::new("robot.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"));
        (text, config)
    }

    #[test]
    fn documented_recording_and_processing_settings_become_a_configuration() {
        let (text, config) = imported(json!({
            "microphoneSamples": 294_912, "microphoneSampleFrequency": 4_500_000, "callSampleFrequency": 450_000,
            "callDuration": 3.0, "callMinimumFrequency": 25_000, "callMaximumFrequency": 80_000, "callEmissions": 1,
            "microphoneLayout": "eRTIS_v3D1", "minRange": 0.5, "maxRange": 5, "directions": 61,
            "azimuthLowLimit": -30, "azimuthHighLimit": 30, "2D": 1, "cleanEnable": true,
        }));
        let recording = config.recording().expect("a format");
        assert_eq!((recording.samples, recording.decimation, recording.sample_rate_hz), (294_912, 10, 4.5e6));
        let emission = &config.emission;
        assert_eq!((emission.start_hz, emission.end_hz, emission.duration_s), (80e3, 25e3, 3e-3));
        assert_eq!((config.imaging.range_min_m, config.imaging.range_max_m), (0.5, 5.0));
        let directions = &config.imaging.directions;
        assert_eq!((directions.start_deg, directions.step_deg, directions.count), (-30.0, 1.0, 61));
        assert_eq!((config.sensor.len(), config.sensor[0].array.as_str()), (1, "ertis-v3d1"));
        assert!(text.contains("# cleanEnable = true") && text.contains("# callEmissions = 1: as here"), "{text}");
    }

    #[test]
    fn no_key_is_lost_and_unknown_ones_are_named() {
        let settings =
            json!({"mystery": [1, 2], "callDuration": "long", "dmasOrder": 3, "directions": 3000, "mode": 0});
        let (text, _) = imported(settings.clone());
        for key in settings.as_object().expect("an object").keys() {
            assert!(text.contains(key.as_str()), "{key} is lost:\n{text}");
        }
        assert!(
            text.contains("# mystery = [1,2]: unknown") && text.contains("# callDuration = \"long\": no number"),
            "{text}"
        );
    }
}
