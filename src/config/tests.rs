//! Contract: defaults are the built-in robot and valid, what is written is read again, the paper's layouts are complete,
//! and nothing that the safe-state contract forbids gets through.

use super::*;
use crate::imaging::params::Beamformer;
use crate::signal::SampleFormat;
use proptest::prelude::*;

fn parse(text: &str) -> Result<Config, DocumentError> {
    Config::parse(text, Path::new("robot.toml"))
}

#[track_caller]
fn refused(text: &str, key: &str) {
    let error = parse(text).expect_err(text);
    assert_eq!(error.key.as_deref(), Some(key), "{error}");
}

#[test]
fn an_empty_file_is_the_built_in_robot() {
    assert_eq!(parse("").unwrap(), Config::default());
    let config = Config::default();
    config.validate().unwrap();
    assert_eq!(config.warnings(), Vec::<String>::new());
    let setups = config.sensor_setups().unwrap();
    let headings: Vec<_> = setups.iter().map(|setup| setup.mount.heading_rad().to_degrees().round()).collect();
    assert_eq!(headings, [0.0, 120.0, -120.0]);
    assert!(setups.iter().all(|setup| setup.mount.distance_m == 0.15 && setup.array.channel_count() == 32));
    assert!(Arc::ptr_eq(&setups[0].emission, &setups[2].emission));
    assert_eq!(config.speed_of_sound_m_s(), 343.0);
    assert_eq!((config.recording().unwrap().samples, config.directions().unwrap().len()), (163_840, 180));
}

#[test]
fn what_is_written_is_read_again_with_a_comment_on_every_key() {
    let air_temperature_c = Some(21.5);
    let mut full = Config { speed_of_sound_given_m_s: None, air_temperature_c, ..Config::default() };
    full.recording.format = SampleFormat::PcmI16;
    full.recording.samples = Some(16_000);
    full.recording.sample_rate_hz = Some(450e3);
    full.imaging.range_step_m = Some(0.004);
    full.imaging.smoothing_hz = Some(20e3);
    full.imaging.focus_to_m = Some(0.0);
    full.sensor[1].disabled_mics = vec![3, 4];
    full.obstruction = vec![
        Shape::Circle { centre_m: [0.4, 0.0], radius_m: 0.05 },
        Shape::Rectangle { x_m: [f64::NEG_INFINITY, -0.5], y_m: [-0.1, 0.1] },
    ];
    full.control.flow_following.set_distance_m = Some(0.8);
    full.ipc.root = Some("/run/elsewhere".into());
    // Products and smoothing exclude each other, so that no one configuration has every key.
    let mut products = Config::default();
    products.imaging.beamformer = Beamformer::DelayMultiplyAndSum;
    products.imaging.multiply_order = Some(3);
    let layouts = LAYOUT_NAMES.iter().map(|name| Config::layout(name).unwrap());
    for config in [Config::default(), full, products].into_iter().chain(layouts) {
        let text = config.to_toml();
        assert_eq!(parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}")), config);
        assert_eq!(uncommented("", &toml::from_str(&text).unwrap()), Vec::<String>::new(), "keys without a comment");
    }
}

/// Dotted keys of a table without a comment, inside shapes and one-line tables excepted.
fn uncommented(path: &str, table: &toml::Table) -> Vec<String> {
    let path_of = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    let keys = table.iter().flat_map(|(key, value)| {
        let below = match value {
            toml::Value::Table(table) if !["mount", "directions"].contains(&key.as_str()) => {
                uncommented(&path_of(key), table)
            }
            toml::Value::Array(array) if key == "sensor" => array
                .iter()
                .filter_map(toml::Value::as_table)
                .flat_map(|table| uncommented(&path_of(key), table))
                .collect(),
            _ => Vec::new(),
        };
        [path_of(key)].into_iter().filter(|path| write::comment(path).is_none()).chain(below)
    });
    keys.collect()
}

#[test]
fn any_sensor_in_the_file_replaces_all_built_in_ones() {
    let config =
        parse("[[sensor]]\nname = \"only\"\nmount = { distance_m = 0.1, bearing_deg = 10, yaw_deg = -10 }").unwrap();
    assert_eq!(config.sensor.len(), 1);
    assert!(config.sensor_setups().unwrap()[0].mount.heading_rad().abs() < 1e-12);
    refused("sensor = []", "sensor");
}

#[test]
fn the_speed_of_sound_is_given_once() {
    assert!((parse("air_temperature_c = 20.0").unwrap().speed_of_sound_m_s() - 343.2).abs() < 0.1);
    assert_eq!(parse("speed_of_sound_m_s = 340").unwrap().speed_of_sound_m_s(), 340.0);
    refused("speed_of_sound_m_s = 343.0\nair_temperature_c = 20.0", "air_temperature_c");
    refused("speed_of_sound_m_s = nan", "speed_of_sound_m_s");
}

#[test]
fn default_regions_follow_the_platform_of_the_file() {
    let config = parse("[platform]\nradius_m = 0.5").unwrap();
    assert_eq!(config.control, ControlParams::for_platform(&config.platform));
    assert_ne!(config.control, ControlParams::default());
    assert_eq!(config.warnings(), Vec::<String>::new());
}

#[test]
fn a_zone_smaller_than_the_stopping_distance_is_refused_with_its_figures() {
    let zone = |radius: f64| {
        format!(
            "[control.collision_avoidance]\nregions = [{{ shape = \"circle\", centre_m = [0, 0], radius_m = {radius} }}]"
        )
    };
    // 0.20 + 0.3 * 0.35 + 0.3^2 / 2 + 0.05 = 0.40 m.
    parse(&zone(0.401)).unwrap();
    let error = parse(&zone(0.395)).unwrap_err();
    let figures = "0.400 m = radius 0.200 + travel 0.105 + braking 0.045 + range error 0.050";
    assert!(error.line == Some(2) && error.summary.contains(figures), "{error}");
    parse(&format!("{}\nenabled = false", zone(0.3))).unwrap();
    refused(&format!("{}\n[safety]\nmax_age_ms = 400", zone(0.401)), "control.collision_avoidance.regions");
    refused(&format!("{}\n[platform]\nmax_linear_m_s = 0.4", zone(0.401)), "control.collision_avoidance.regions");
    let hole =
        "[control.collision_avoidance]\nregions = [{ shape = \"rectangle\", x_m = [0.3, 1.0], y_m = [-0.3, 0.3] }]";
    refused(hole, "control.collision_avoidance.regions");
}

#[test]
fn a_zone_narrower_than_the_robot_and_no_zone_at_all_are_warned_of() {
    let narrow =
        "[control.collision_avoidance]\nregions = [{ shape = \"rectangle\", x_m = [0, 1], y_m = [-0.15, 0.15] }]";
    let warnings = parse(narrow).unwrap().warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("edge reaches"), "{warnings:?}");
    let off = parse("[control.collision_avoidance]\nenabled = false").unwrap().warnings();
    assert!(off.len() == 1 && off[0].contains("off"), "{off:?}");
}

#[test]
fn a_coarse_range_step_is_warned_of() {
    let warnings = |step: f64| parse(&format!("[imaging]\nrange_step_m = {step}")).unwrap().warnings();
    assert_eq!(warnings(0.005), Vec::<String>::new());
    assert!(warnings(0.0055)[0].contains("coarser than 0.0050"));
    // The wide band of 55 kHz needs 343 / (2.4 * 55e3) = 2.6 mm.
    let wide = parse("[emission]\nstart_hz = 80e3\n[imaging]\nrange_step_m = 0.004").unwrap().warnings();
    assert!(wide[0].contains("coarser than 0.0026"), "{wide:?}");
}

#[test]
fn ranges_beyond_the_recording_and_bands_beyond_nyquist_are_refused() {
    // 36.41 ms less the 2.5 ms of the emission: 5.815 m.
    parse("[imaging]\nrange_max_m = 5.81").unwrap();
    refused("[imaging]\nrange_max_m = 5.82", "imaging.range_max_m");
    let pcm = "[recording]\nformat = \"pcm-i16\"\nsamples = 16384\nsample_rate_hz = ";
    // 50 kHz and 2.5 kHz of passband edge: just below half of 105.2 kHz.
    parse(&format!("{pcm}105200\n")).unwrap();
    refused(&format!("{pcm}104900\n"), "emission.start_hz");
    refused("[emission]\nstart_hz = 30e3\nend_hz = 2e3", "emission.end_hz");
}

/// The text of the defaults with each of its numbers in turn replaced.
fn with_each_number_replaced(by: &str) -> Vec<String> {
    let text = Config::default().to_toml();
    let mut texts = Vec::new();
    let mut start_of_line = 0;
    for line in text.split_inclusive('\n') {
        let is_number = |c: char| c.is_ascii_digit() || c == '-' || c == '.';
        let mut from = 0;
        while let Some(start) = line[from..].find(is_number).map(|found| from + found) {
            let end = start + line[start..].find(|c: char| !is_number(c)).unwrap_or(line.len() - start);
            let alone =
                start > 0 && line[..start].ends_with([' ', '[']) && line[end..].starts_with(['\n', ',', ']', ' ']);
            if alone && !line.starts_with('#') {
                let (before, after) = (start_of_line + start, start_of_line + end);
                texts.push(format!("{}{by}{}", &text[..before], &text[after..]));
            }
            from = end;
        }
        start_of_line += line.len();
    }
    texts
}

#[test]
fn nan_or_minus_infinity_for_any_number_of_the_file_is_refused_on_its_line() {
    for by in ["nan", "-inf"] {
        let texts = with_each_number_replaced(by);
        assert!(texts.len() > 90, "{} numbers", texts.len());
        for text in texts {
            let changed =
                text.lines().position(|line| line.split([' ', '[', ',', ']']).any(|word| word == by)).unwrap();
            // A half-plane is a region too: only a rectangle's own numbers may be infinite, and a fan's ends.
            match parse(&text) {
                Err(error) => assert_eq!(error.line, Some(changed + 1), "{error}"),
                Ok(_) => {
                    let line = text.lines().nth(changed).unwrap_or_default();
                    assert!(
                        by == "-inf" && (line.contains("rectangle") || line.contains("flow-lines")),
                        "{by}: {line}"
                    );
                }
            }
        }
    }
}

#[test]
fn paths_are_relative_to_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    std::fs::write(folder.path().join("two.csv"), "mic,x_m,y_m,z_m\n0,0,0,0\n1,0,0.01,0\n").unwrap();
    std::fs::write(folder.path().join("fan.csv"), "azimuth_deg,elevation_deg\n-10,0\n10,5\n").unwrap();
    std::fs::write(folder.path().join("call.csv"), "0\n0.5\n-0.5\n0\n").unwrap();
    let text = "[ipc]\nroot = \"shm\"\n[imaging.directions]\nfile = \"fan.csv\"\n[emission]\nshape = \"csv\"\nfile = \"call.csv\"\n\
                [[sensor]]\nname = \"a\"\narray = \"two.csv\"\n";
    std::fs::write(&path, text).unwrap();
    let config = Config::load(&path).unwrap();
    assert_eq!(config.sensor_setups().unwrap()[0].array.channel_count(), 2);
    assert_eq!((config.directions().unwrap().len(), config.emissions().unwrap()[0].samples.len()), (2, 4));
    assert_eq!(config.ipc.root.as_deref(), Some(folder.path().join("shm").as_path()));
    std::fs::write(folder.path().join("fan.csv"), "azimuth_deg,elevation_deg\n-10,0\n300,5\n").unwrap();
    let error = Config::load(&path).unwrap_err();
    assert!(error.line == Some(4) && error.summary.contains("fan.csv line 3: \"300\""), "{error}");
}

#[test]
fn pdm_carries_32_microphones_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    let rows: String = (0..33).map(|mic| format!("{mic},0,{},0\n", f64::from(mic) * 1e-3)).collect();
    std::fs::write(folder.path().join("many.csv"), format!("mic,x_m,y_m,z_m\n{rows}")).unwrap();
    let sensor = "[[sensor]]\nname = \"a\"\narray = \"many.csv\"\n";
    let error = Config::parse(sensor, &path).unwrap_err();
    assert_eq!((error.key.as_deref(), error.line), (Some("sensor[0].array"), Some(3)), "{error}");
    Config::parse(&format!("{sensor}[recording]\nformat = \"pcm-f32\""), &path).unwrap();
}

#[test]
fn every_layout_of_the_paper_is_valid_and_has_the_platform_and_gains_of_its_experiment() {
    for name in LAYOUT_NAMES {
        let config = Config::layout(name).unwrap();
        config.validate().unwrap_or_else(|error| panic!("{name}: {error}"));
        let (radius_m, gain) = if name.starts_with("sim") { (0.10, 1.0) } else { (0.60, 0.1) };
        assert_eq!((config.platform.radius_m, config.platform.max_linear_m_s), (radius_m, 0.3));
        let control = &config.control;
        let gains = [control.obstacle_avoidance.lambda, control.obstacle_avoidance.mu, control.flow_following.lambda];
        assert_eq!((gains, control.corridor_following.lambda), ([gain; 3], gain));
    }
    let mounts = |name: &str| -> Vec<[f64; 3]> {
        let mounts = Config::layout(name).unwrap().sensor.into_iter().map(|sensor| sensor.mount);
        mounts.map(|mount| [mount.bearing_deg, mount.yaw_deg, mount.distance_m]).collect()
    };
    assert_eq!(mounts("sim-8"), [[0.0, 0.0, 0.0], [120.0, -120.0, 0.14], [-120.0, 120.0, 0.14]]);
    assert_eq!(mounts("real-3"), [[0.0, -12.0, 0.41], [180.0, 35.0, 0.27], [58.0, 2.0, 0.31]]);
    let all: usize = LAYOUT_NAMES.iter().map(|name| mounts(name).len()).sum();
    assert_eq!(all, 23 + 15, "sensors in tables 1 and 2");
    assert!(Config::layout("sim-11").unwrap_err().allowed.contains("sim-10, real-1"));
}

#[test]
fn an_obstruction_around_a_sensor_or_across_its_whole_view_is_refused() {
    refused("[[obstruction]]\nshape = \"circle\"\ncentre_m = [0.15, 0]\nradius_m = 0.01", "obstruction[0]");
    let wall = "[[obstruction]]\nshape = \"rectangle\"\nx_m = [0.16, 0.2]\ny_m = [-inf, inf]";
    refused(wall, "sensor[0]");
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = parse(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn no_number_in_any_place_of_the_defaults_makes_the_validator_panic(
        place in 0usize..400, number in prop::sample::select(vec![
            "0", "-1", "1", "1e300", "-1e300", "5e-324", "nan", "inf", "-inf", "-0.0", "9223372036854775807", "true", "\"x\"", "[]", "{}",
        ]),
    ) {
        let text = Config::default().to_toml();
        let keys: Vec<usize> = text.match_indices(" = ").map(|(start, _)| start + 3).collect();
        let start = keys[place % keys.len()];
        let end = start + text[start..].find(['\n', ',', ']', '}']).unwrap_or(text.len() - start);
        let _ = parse(&format!("{}{number}{}", &text[..start], &text[end..]));
    }
}
