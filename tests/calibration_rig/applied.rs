//! Contract: of a calibration that is applied which is listed, and nothing implausible; the command writes what the configuration
//! reads; and a calibrated sensor images better.

use super::*;
use crate::checks::{is_full, trials};
use nalgebra::Vector3;
use noctule::calibration::file::geometry_of;
use noctule::calibration::{Applied, Calibration};
use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::io::encode_png;
use noctule::io::plot::{CurvePanel, CurvePoint, curves};
use noctule::signal::{Direction, Energyscape, MaskTable};
use noctule::sim::Pillar;
use npyz::WriterBuilder as _;
use std::path::Path;

#[test]
fn what_is_applied_is_what_is_listed_and_what_is_implausible_is_named() {
    let truth = crooked(20.0, 4);
    let observer = observe(&truth, SampleFormat::PcmF32, 40, 4);
    let good = Calibration {
        calibration_version: 1,
        recorded: "2026-01-02T03:04:05Z".to_owned(),
        sensor: vec![measured(&observer, &truth, true)],
        cross: Vec::new(),
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("robot.toml");
    let write = |calibration: &Calibration| {
        std::fs::write(folder.path().join("calibration.toml"), calibration.to_toml()).expect("written");
    };
    let config =
        |apply: &str| Config::parse(&format!("[calibration]\nfile = \"calibration.toml\"\napply = [{apply}]\n"), &path);
    write(&good);
    let read = config("").expect("a good file");
    assert_eq!(read.calibration.measured.as_deref(), Some(&good), "nothing is lost on the way through the file");
    let setup = |apply: &str| config(apply).expect("good").sensor_setups().expect("sensors").remove(0);
    let plain = setup("");
    assert_eq!((plain.emitter_m, geometry_of(&plain)), (nominal().emitter_m, geometry_of(&nominal())));
    let front = &good.sensor[0];
    assert_eq!(setup("\"emitter\"").emitter_m, Vector3::from(front.emitter_m));
    let moved = setup("\"microphones\"").array.positions_m[3] - nominal().array.positions_m[3];
    assert!((moved.norm() - front.path_m[3].abs()).abs() < 1e-12);
    let weight = setup("\"gains\"").array.weights[3];
    assert!((f64::from(weight) - 10f64.powf(-front.gain_db[3] / 20.0)).abs() < 1e-6);
    assert_eq!(config("\"speed-of-sound\"").expect("good").speed_of_sound_m_s(), front.speed_of_sound_m_s);
    assert_eq!(config("\"emitter\"").expect("good").speed_of_sound_m_s(), 343.0);
    assert_eq!(
        config("\"emitter\"").expect("good").uncalibrated().sensor_setups().expect("sensors")[0].emitter_m,
        nominal().emitter_m
    );
    // What is known badly is not applied without a word.
    let mut blind = good.clone();
    blind.sensor[0] = measured(&observer, &truth, false);
    write(&blind);
    let warned = |apply: &str| config(apply).expect("good").warnings().join("\n");
    assert!(
        warned("\"speed-of-sound\"").contains("--air-temperature-c") && warned("\"gains\"").contains("left, right")
    );
    assert!(!warned("\"gains\"").contains("--air-temperature-c") && !warned("").contains("calibration"));
    let refused = |spoil: &dyn Fn(&mut SensorCalibration), words: &[&str]| {
        let mut bad = good.clone();
        spoil(&mut bad.sensor[0]);
        write(&bad);
        let error = config("\"emitter\"").expect_err("implausible").to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    refused(&|one| one.speed_of_sound_m_s = 401.0, &["calibration.file", "speed_of_sound_m_s", "401", "300 to 380"]);
    refused(&|one| one.path_m[7] = 7.2e-3, &["microphone 7", "front", "0.0072", "0.004"]);
    refused(&|one| one.emitter_m[2] += 15e-3, &["emitter", "front", "10 mm"]);
    refused(&|one| one.geometry = "00000000".to_owned(), &["another array or emitter", "noctule calibrate"]);
    refused(&|one| one.gain_db.truncate(31), &["gain_db", "31 numbers", "32"]);
    refused(&|one| one.path_sd_m[0] = f64::NAN, &["path_sd_m", "NaN"]);
    std::fs::remove_file(folder.path().join("calibration.toml")).expect("removed");
    let error = config("").expect_err("no file").to_string();
    assert!(error.contains("calibration.file") && error.contains("no such file"), "{error}");
    let error = Config::parse("[calibration]\napply = [\"gains\"]\n", Path::new("robot.toml")).expect_err("no file");
    assert!(error.to_string().contains("calibration.apply"), "{error}");
}

/// What a sensor that is taken for `believed` makes of a ping: the image of a horizontal fan, or of one straight up and down.
fn image_of(believed: &SensorSetup, set: &PingSet, upright: bool) -> Energyscape {
    let params = ImagingParams::default();
    let fan = || horizontal_directions(&params.directions).expect("directions");
    // The pillar stands 0.2 rad to the left.
    let up = |degrees: i32| Direction { azimuth_rad: 0.2, elevation_rad: f64::from(degrees).to_radians() };
    let directions = if upright { (-80..=80).map(up).collect() } else { fan() };
    let hidden = [vec![false; directions.len()]];
    let recording = recording_of(SampleFormat::PcmF32, SAMPLES);
    let plan = ImagingPlan::new(std::slice::from_ref(believed), &hidden, &recording, &params, directions, SPEED_M_S);
    let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
    let plan = Arc::new(plan.expect("plan"));
    let mut imager = Imager::open(plan, Arc::new(MaskTable::default()), Prefer::Cpu, options).expect("CPU");
    imager.image(set).expect("image").energyscapes[0].clone()
}

/// Distance of the image of a pillar from what the true sensor would make of it, as configured and as calibrated, when microphones lie
/// `misplaced_m` (in each direction of the plane) and gains `gains_db` off. Sine of the angle between the images as vectors: the
/// best common scale is taken, so that only the shape counts.
fn distances(misplaced_m: f64, gains_db: f64, seed: u64, upright: bool) -> [f64; 2] {
    let mut random = Random(90 + seed);
    let mut truth = Truth::as_configured();
    truth.params.direct_amplitude = 0.25;
    for place_m in &mut truth.sensor.array.positions_m {
        *place_m += Vector3::new(0.0, misplaced_m * random.gaussian(), misplaced_m * random.gaussian());
    }
    truth.gains = (0..32).map(|_| 10f64.powf(gains_db * random.gaussian() / 20.0)).collect();
    let observer = observe(&truth, SampleFormat::PcmF32, 24, seed);
    let tolerances = Tolerances { speed_m_s: 0.3, place_m: misplaced_m.max(0.1e-3), ..Tolerances::default() };
    let found = measure(&observer, &nominal(), truth.speed_m_s, &tolerances).expect("measured");
    let mut calibrated = nominal();
    found.apply(&[Applied::Emitter, Applied::Microphones, Applied::Gains], &mut calibrated);
    let mut perfect = truth.sensor.clone();
    perfect.array.weights = truth.gains.iter().map(|gain| (1.0 / gain) as f32).collect();
    let world = World { pillars: vec![Pillar { centre: [1.4, 0.6], radius_m: 0.02 }], ..World::default() };
    let shown = Truth { world, samples: SAMPLES, ..truth };
    let mut found = [0.0; 2];
    shown.pings(1, SampleFormat::PcmF32, seed, |set| {
        let best = image_of(&perfect, set, upright).values;
        found = [&nominal(), &calibrated].map(|believed| {
            let other = image_of(believed, set, upright).values;
            let product =
                |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
            (1.0 - product(&best, &other).powi(2) / (product(&best, &best) * product(&other, &other))).max(0.0).sqrt()
        });
    });
    found
}

#[test]
fn a_calibrated_sensor_images_a_pillar_nearer_to_what_a_perfect_one_would() {
    // The curves of the picture, and in a plain run their middles.
    let (misplaced, gains): (&[f64], &[f64]) =
        if is_full() { (&[0.2, 0.4, 0.7, 1.0, 1.5], &[0.5, 1.0, 2.0, 3.0, 5.0]) } else { (&[0.7], &[3.0]) };
    let rounds = trials(20, 3) as u64;
    let mean = |misplaced_m: f64, gains_db: f64, upright: bool| {
        let all = (0..rounds).map(|seed| distances(misplaced_m, gains_db, seed, upright));
        all.fold([0.0; 2], |sum, one| [0, 1].map(|index| sum[index] + one[index] / rounds as f64))
    };
    let curve = |x_title: &str, values: &[f64], mean: &dyn Fn(f64) -> [f64; 2]| {
        let point = |x: f64| {
            let [expected, measured] = mean(x);
            println!("{x_title} {x}: as configured {expected:.3}, calibrated {measured:.3}");
            CurvePoint { x, measured, expected }
        };
        CurvePanel { x_title: x_title.to_owned(), points: values.iter().map(|x| point(*x)).collect() }
    };
    let places = curve("microphones misplaced, mm: horizontal image", misplaced, &|mm| mean(1e-3 * mm, 0.0, false));
    let heights = curve("microphones misplaced, mm: upright image", misplaced, &|mm| mean(1e-3 * mm, 0.0, true));
    let gains = curve("gains off, dB: horizontal image", gains, &|gain_db| mean(0.0, gain_db, false));
    // Only the part of a displacement along the line from the emitter shows. The emitter stands above the array, so that is mostly
    // its height, which a horizontal image hardly depends on: it must do no harm. Of gains all shows.
    for point in &places.points {
        assert!(point.measured < 1.05 * point.expected, "{point:?}");
    }
    for point in &heights.points {
        assert!(point.measured < 0.7 * point.expected, "{point:?}");
    }
    for point in &gains.points {
        assert!(point.measured < 0.35 * point.expected, "{point:?}");
    }
    if let Some(path) = std::env::var_os("NOCTULE_PICTURE") {
        let titles = [
            "Distance of the image of a pillar from that of a perfect sensor",
            "sine of the angle between the images; 0 is the same image",
        ];
        let picture = curves(&[places, heights, gains], titles, "distance", ["calibrated", "as configured"]);
        encode_png(std::fs::File::create(path).expect("file"), &picture).expect("picture");
    }
}

/// Writes pings as a recording of 16-bit samples.
fn write_recording(path: &Path, truth: &Truth, count: usize) {
    let mut values: Vec<i16> = Vec::new();
    let whole = Truth { samples: SAMPLES, ..truth.clone() };
    whole.pings(count, SampleFormat::PcmI16, 2, |set| match set.pings[0].samples.as_ref() {
        Samples::PcmI16(heard) => values.extend(heard),
        _ => panic!("another format"),
    });
    let file = std::fs::File::create(path).expect("file");
    let shape = [count as u64, 32, SAMPLES as u64];
    let options = npyz::WriteOptions::new().default_dtype().shape(&shape);
    let mut writer = options.writer(std::io::BufWriter::new(file)).begin_nd().expect("header");
    writer.extend(values).expect("written");
    writer.finish().expect("finished");
}

fn noctule(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = assert_cmd::Command::cargo_bin("noctule").expect("program");
    let output = { output }.current_dir(folder).args(arguments).output().expect("run");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().expect("code"), text(&output.stdout), text(&output.stderr))
}

#[test]
fn the_command_measures_a_recording_and_the_configuration_takes_its_file() {
    let folder = tempfile::tempdir().expect("folder");
    let folder = folder.path();
    let truth = crooked(30.0, 6);
    write_recording(&folder.join("a.npy"), &truth, 8);
    let config = "[recording]\nformat = \"pcm-i16\"\n";
    std::fs::write(folder.join("robot.toml"), config).expect("written");
    let arguments = ["calibrate", "a.npy", "--config", "robot.toml", "--out", "calibration.toml"];
    let (code, told, error) = noctule(folder, &[&arguments[..], &["--air-temperature-c", "30", "--json"]].concat());
    assert_eq!(code, 0, "{error}");
    let json: serde_json::Value = serde_json::from_str(&told).expect("JSON");
    let front = &json["sensor"][0];
    assert_eq!((front["name"].as_str(), front["pings"].as_u64()), (Some("front"), Some(8)));
    let found_m = front["emitter_m"][1].as_f64().expect("number");
    assert!((found_m - truth.sensor.emitter_m.y).abs() < 1e-3, "{front}");
    assert!((front["air_temperature_c"].as_f64().expect("number") - 30.0).abs() < 1.5);
    let (code, told, _) = noctule(folder, &arguments);
    assert!(code == 0 && told.contains("front: 8 pings") && told.contains("not observable"), "{told}");
    let applied =
        format!("{config}[calibration]\nfile = \"calibration.toml\"\napply = [\"speed-of-sound\", \"gains\"]\n");
    std::fs::write(folder.join("robot.toml"), applied).expect("written");
    let (code, told, error) = noctule(folder, &["check", "robot.toml", "--json"]);
    assert!(told.contains("\"applied\":[\"speed-of-sound\",\"gains\"]"), "{code} {told} {error}");
    assert!(noctule(folder, &["config", "--config", "robot.toml"]).1.contains("file = \"calibration.toml\""));
    // What is already applied does not bend a new measurement.
    assert_eq!(noctule(folder, &arguments).0, 0);
    // Air that there is not, a recording that is none, a temperature of no place.
    write_recording(&folder.join("cold.npy"), &Truth { speed_m_s: 280.0, ..Truth::as_configured() }, 8);
    let bad = |arguments: &[&str], code: i32, words: &[&str]| {
        let (found, _, error) = noctule(folder, arguments);
        assert!(found == code && words.iter().all(|word| error.contains(word)), "{found}: {error}");
        assert!(!folder.join("new.toml").exists());
    };
    std::fs::write(folder.join("plain.toml"), config).expect("written");
    let with = |input: &'static str| ["calibrate", input, "--config", "plain.toml", "--out", "new.toml"];
    bad(&with("cold.npy"), 65, &["implausible", "speed_of_sound_m_s", "300 to 380"]);
    bad(&with("robot.toml"), 65, &["robot.toml"]);
    bad(&[&with("a.npy")[..], &["--air-temperature-c", "200"]].concat(), 2, &["200", "-40 to 85"]);
    bad(&[&with("a.npy")[..], &["--sensor", "frnt"]].concat(), 2, &["frnt", "front"]);
}
