//! Contract: the Python example shows what was published, to the digit, the picture shows it at its place, and Python's
//! `ctypes` lays every wire type out as Rust does. With the real wheel; `NOCTULE_REQUIRE_PYTHON=1` makes its absence a failure.

mod client_rig;
mod ipc_rig;

use client_rig::{Publisher, RANGES, SENSORS, compare, python_is_missing, run, stdout};
use ipc_rig::Place;
use noctule::io::Echo;
use noctule::io::topics::topics_json;
use noctule::io::wire::detections::{Objects, Obstacle, Scan};
use noctule::io::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, RawHeader, VelocityCommand, VelocityInput,
};
use noctule::io::wire::motion::EgoMotion;
use noctule::io::wire::points::PointCloud3;
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::io::wire::{Field, WireType};
use noctule::signal::SampleFormat;
use serde_json::Value;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs the client with the topics in a file, publishing a ping set every 40 ms meanwhile.
fn run_client(publisher: &mut Publisher, topics: &Value, arguments: &[&str]) -> Output {
    let file = publisher.topics_file(topics);
    let mut client = client(&["--topics", file.to_str().expect("UTF-8")]);
    run(client.args(arguments), || publisher.publish_next())
}

fn client(arguments: &[&str]) -> Command {
    let mut command = Command::new("python3");
    // No byte code in the source tree, and no settings of this user's matplotlib.
    command.args(["-B", concat!(env!("CARGO_MANIFEST_DIR"), "/examples/energyscape_live.py")]).args(arguments);
    command.env("MPLCONFIGDIR", concat!(env!("CARGO_TARGET_TMPDIR"), "/matplotlib"));
    command
}

fn assert_fails(output: &Output, code: i32, words: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(text.contains(words), "{words:?} is not in: {text}");
    assert_eq!(text.trim().lines().count(), 1, "one line: {text}");
}

#[test]
fn printed_numbers_are_those_that_were_published() {
    if python_is_missing() {
        return;
    }
    let mut publisher = Publisher::new();
    let topics = publisher.topics_json();
    let arguments = ["--sensor", "left", "--print", "--count", "8", "--timeout", "20"];
    let output = run_client(&mut publisher, &topics, &arguments);
    assert_eq!(compare(stdout(&output), &publisher.published), Ok(8));

    // Negative control: two fields of one type exchange their places, and nothing else tells.
    let mut swapped = topics;
    for service in swapped["services"].as_array_mut().expect("services") {
        swap_fields(&mut service["header"], "range_first_m", "range_step_m");
    }
    let output = run_client(&mut publisher, &swapped, &arguments);
    let verdict = compare(stdout(&output), &publisher.published);
    assert!(verdict.is_err(), "{verdict:?}");
    // With the hash that such a layout has, the client itself refuses.
    for service in swapped["services"].as_array_mut().expect("services") {
        if let Some(hash) = service["header"].get_mut("schema_hash") {
            *hash = 1.into();
        }
    }
    assert_fails(&run_client(&mut publisher, &swapped, &arguments), 65, "another header layout");
}

/// Exchanges the names of two fields, wherever a description has both.
fn swap_fields(described: &mut Value, first: &str, second: &str) {
    let Some(fields) = described.get_mut("fields").and_then(Value::as_array_mut) else { return };
    let index = |name: &str| fields.iter().position(|field| field["name"] == name);
    if let (Some(first), Some(second)) = (index(first), index(second)) {
        let name = fields[first]["name"].take();
        fields[first]["name"] = fields[second]["name"].take();
        fields[second]["name"] = name;
    }
}

#[test]
fn a_client_that_comes_late_gets_the_newest_ping_at_once_and_leaves_nothing_behind() {
    if python_is_missing() {
        return;
    }
    let mut publisher = Publisher::new();
    for _ in 0..3 {
        publisher.publish_next();
    }
    let before = publisher.place.left_behind();
    let file = publisher.topics_file(&publisher.topics_json());
    let mut client =
        client(&["--topics", file.to_str().expect("UTF-8"), "--sensor", "left", "--print", "--count", "1"]);
    let output = run(client.args(["--timeout", "20"]), || publisher.topics.connect_latecomers().expect("connected"));
    assert_eq!(compare(stdout(&output), &publisher.published), Ok(1));
    assert!(stdout(&output).contains(&format!("sequence={} ", publisher.sequence)), "{output:?}");
    // The publisher holds its end of a connection until it next looks who is there, and the client went after the last look.
    publisher.topics.connect_latecomers().expect("connected");
    assert_eq!(added(&before, &publisher.place), Vec::<String>::new());

    // Negative control: a reader that stays is seen, and so is the connection of one that the publisher does not know gone.
    let (ipc, sensors) = (&publisher.place.ipc, SENSORS.map(str::to_owned));
    let reader = Echo::open(ipc, "noctule/sonar/left/energyscape", true, &sensors, SampleFormat::PcmI16);
    publisher.topics.connect_latecomers().expect("connected");
    assert!(added(&before, &publisher.place).len() > 1);
    drop(reader.expect("opened"));
    let held = added(&before, &publisher.place);
    assert!(held.len() == 1 && held[0].ends_with(".connection"), "{held:?}");
    publisher.topics.connect_latecomers().expect("connected");
    assert_eq!(added(&before, &publisher.place), Vec::<String>::new());
}

/// Files that are there now and were not before.
fn added(before: &[String], place: &Place) -> Vec<String> {
    place.left_behind().into_iter().filter(|name| !before.contains(name)).collect()
}

#[test]
fn the_command_itself_tells_the_client_everything() {
    if python_is_missing() {
        return;
    }
    let mut publisher = Publisher::new();
    let config = publisher.place.config_file();
    let mut client = client(&["--noctule", env!("CARGO_BIN_EXE_noctule"), "--config", config.to_str().expect("UTF-8")]);
    // No sensor is named: the first one of the configuration, whose peak stays at direction 1, range 2.
    let output = run(client.args(["--print", "--count", "2", "--timeout", "20"]), || publisher.publish_next());
    for line in stdout(&output).lines() {
        assert!(line.starts_with("range_m=0.4250 bearing_deg=-84.000 value=0.5 "), "{line}");
    }
    assert_eq!(stdout(&output).lines().count(), 2);
}

/// A decoded picture.
struct Pixels {
    width: usize,
    rgb: Vec<[u8; 3]>,
}

impl Pixels {
    fn open(path: &Path) -> Self {
        let file = std::io::BufReader::new(std::fs::File::open(path).expect("a file"));
        let mut decoder = png::Decoder::new(file);
        decoder.set_transformations(png::Transformations::normalize_to_color8() | png::Transformations::ALPHA);
        let mut reader = decoder.read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("size")];
        let info = reader.next_frame(&mut bytes).expect("a picture");
        assert_eq!(info.color_type, png::ColorType::Rgba);
        let rgb = bytes[..info.buffer_size()].chunks_exact(4).map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
        Self { width: info.width as usize, rgb }
    }

    /// Centre, in pixels from the top left, of what has the colour map's brightest colours, left of the colour bar.
    fn brightest(&self) -> Option<(f64, f64)> {
        let places = self.rgb.iter().enumerate().map(|(index, rgb)| (index % self.width, index / self.width, rgb));
        let bright: Vec<(f64, f64)> = places
            .filter(|&(x, _, &[red, green, blue])| x < self.width * 9 / 10 && red > 240 && green > 230 && blue < 200)
            .map(|(x, y, _)| (x as f64, y as f64))
            .collect();
        let count = bright.len() as f64;
        let (x, y) = bright.iter().fold((0.0, 0.0), |sum, pixel| (sum.0 + pixel.0, sum.1 + pixel.1));
        (count > 0.0).then_some((x / count, y / count))
    }

    fn colour_count(&self) -> usize {
        self.rgb.iter().collect::<std::collections::BTreeSet<_>>().len()
    }
}

#[test]
fn the_picture_shows_the_peak_where_it_was_forward_up_and_left_to_the_left() {
    if python_is_missing() {
        return;
    }
    let mut publisher = Publisher::new();
    let file = publisher.topics_file(&publisher.topics_json());
    let picture = publisher.place.directory.path().join("picture.png");
    // Of a fan of 90 degrees to either side the example draws: its origin, and 5 in = 360 pixels for the largest range.
    let (origin_x, origin_y, radius_px, range_max_m) = (396.0, 482.0, 360.0, 0.4 + 0.0125 * (RANGES as f64 - 0.5));
    for (direction, column) in [(37, 200), (10, 120)] {
        let arguments = ["--sensor", "left", "--timeout", "20", "--once", picture.to_str().expect("UTF-8")];
        let mut client = client(&["--topics", file.to_str().expect("UTF-8")]);
        let output = run(client.args(arguments), || {
            publisher.sequence += 1;
            publisher.publish_peak(1, direction, column, 0.7);
        });
        assert_eq!(stdout(&output), "");
        let pixels = Pixels::open(&picture);
        assert_eq!((pixels.width, pixels.rgb.len()), (900, 900 * 540));
        // The colour bar has 256 colours, text and lines some greys; the image made 1,900 of them in all.
        assert!(pixels.colour_count() > 600, "{} colours", pixels.colour_count());
        let (x, y) = pixels.brightest().expect("a bright cell");
        let bearing_rad = (-88.0 + 4.0 * direction as f64).to_radians();
        let from_origin_px = radius_px * (0.4 + 0.0125 * column as f64) / range_max_m;
        let expected = (origin_x - from_origin_px * bearing_rad.sin(), origin_y - from_origin_px * bearing_rad.cos());
        // Measured: 1.0 and 1.3. The brightest cell is up to 18 pixels wide and 1 deep, drawn without smoothing.
        assert!((x - expected.0).hypot(y - expected.1) < 2.5, "({x:.1}, {y:.1}), not {expected:.1?}");
    }
    let blank = Pixels { width: 900, rgb: vec![[255; 3]; 900 * 540] };
    assert!(blank.brightest().is_none() && blank.colour_count() == 1, "a blank picture does not pass");
}

#[test]
fn where_nothing_is_published_the_client_says_so_in_time_and_makes_nothing() {
    if python_is_missing() {
        return;
    }
    let publisher = Publisher::new();
    let mut topics = publisher.topics_json();
    let file = publisher.topics_file(&topics);
    let silent = run(&mut client(&["--topics", file.to_str().expect("UTF-8"), "--print", "--timeout", "1"]), || {});
    assert_fails(&silent, 69, "no ping for 1 s");

    let stranger = run(&mut client(&["--topics", file.to_str().expect("UTF-8"), "--sensor", "rear"]), || {});
    assert_fails(&stranger, 2, "sensors are: front, left, right");

    let root = publisher.place.directory.path().join("elsewhere");
    topics["root"] = root.to_str().expect("UTF-8").into();
    let file = publisher.topics_file(&topics);
    let absent = run(&mut client(&["--topics", file.to_str().expect("UTF-8"), "--print", "--timeout", "1"]), || {});
    assert_fails(&absent, 69, "is not published");
    assert!(!root.exists(), "the root is noctule's to make");

    std::fs::write(&file, "{\"services\": 1}").expect("written");
    let broken = run(&mut client(&["--topics", file.to_str().expect("UTF-8")]), || {});
    assert_fails(&broken, 65, "not what `noctule topics --json` writes");
}

#[test]
fn shared_memory_that_a_dead_process_left_half_made_cannot_hold_the_client() {
    if python_is_missing() {
        return;
    }
    let publisher = Publisher::new();
    let file = publisher.topics_file(&publisher.topics_json());
    let Publisher { place, topics, .. } = publisher;
    drop(topics);
    let names = ipc_rig::shared_memory_files(&place.params.prefix);
    let management = names.iter().find(|name| name.ends_with("global_mgmt")).expect("it outlives its users");
    std::fs::File::create(Path::new("/dev/shm").join(management)).expect("emptied");
    let begin = Instant::now();
    let output = run(&mut client(&["--topics", file.to_str().expect("UTF-8"), "--print"]), || {});
    // Ended by the watchdog after 3 s, where the transport would wait for ever.
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("Timeout"), "{output:?}");
    assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", begin.elapsed());
}

#[test]
fn another_version_of_the_wheel_is_named_as_the_cause() {
    if python_is_missing() {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    let metadata = directory.path().join("iceoryx2-0.10.1.dist-info");
    std::fs::create_dir(&metadata).expect("directory");
    std::fs::write(metadata.join("METADATA"), "Metadata-Version: 2.1\nName: iceoryx2\nVersion: 0.10.1\n")
        .expect("written");
    let output = run(client(&["--print"]).env("PYTHONPATH", directory.path()), || {});
    assert_fails(&output, 69, "iceoryx2 0.10.1 is here, but noctule speaks 0.10.0");
}

/// Type name, size, alignment, schema hash and fields as Rust has them.
type RustLayout = (&'static str, usize, usize, u64, &'static [Field]);

fn rust_layouts() -> [RustLayout; 14] {
    fn of<T: WireType>() -> RustLayout {
        (T::TYPE_NAME, size_of::<T>(), align_of::<T>(), T::SCHEMA_HASH, T::FIELDS)
    }
    [
        of::<RawHeader>(),
        of::<EnergyscapeHeader>(),
        of::<Cues>(),
        of::<VelocityCommand>(),
        of::<VelocityInput>(),
        of::<OperatorRequest>(),
        of::<Odometry>(),
        of::<PlatformVelocity>(),
        of::<Scan>(),
        of::<Obstacle>(),
        of::<Objects>(),
        of::<EgoMotion>(),
        of::<PointCloud3>(),
        of::<Health>(),
    ]
}

/// What Python's `ctypes` makes of the order and types of fields.
fn python_layouts(topics: &Value) -> Value {
    let mut child = Command::new("python3")
        .args(["-B", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python/layout.py")])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("started");
    child.stdin.take().expect("piped").write_all(topics.to_string().as_bytes()).expect("written");
    let output = child.wait_with_output().expect("output");
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Everything in which Python's layouts differ from Rust's.
fn differences(python: &Value) -> Vec<String> {
    let mut found = Vec::new();
    for (type_name, size, alignment, schema_hash, fields) in rust_layouts() {
        let laid_out = &python[type_name];
        let mut expect = |what: &str, python: &Value, rust: u64| {
            if python.as_u64() != Some(rust) {
                found.push(format!("{type_name} {what}: {python} in Python, {rust} in Rust"));
            }
        };
        expect("size", &laid_out["size"], size as u64);
        expect("alignment", &laid_out["alignment"], alignment as u64);
        expect("schema hash", &laid_out["schema_hash"], schema_hash);
        expect("fields", &laid_out["offsets"].as_object().map_or(0, serde_json::Map::len).into(), fields.len() as u64);
        for field in fields {
            expect(field.name, &laid_out["offsets"][field.name], field.offset as u64);
        }
    }
    found
}

#[test]
fn python_lays_every_wire_type_out_as_rust_does() {
    if python_is_missing() {
        return;
    }
    let sensors = SENSORS.map(str::to_owned);
    let mut topics = topics_json(&noctule::io::IpcParams::default(), &sensors, SampleFormat::Pdm);
    let python = python_layouts(&topics);
    assert_eq!(python.as_object().expect("types").len(), rust_layouts().len(), "every type, and no other");
    assert_eq!(differences(&python), Vec::<String>::new());

    // Negative control: V and omega of the command change places, which neither sizes nor type names tell.
    for service in topics["services"].as_array_mut().expect("services") {
        swap_fields(&mut service["payload"], "linear_m_s", "angular_rad_s");
    }
    let found = differences(&python_layouts(&topics));
    for type_name in ["VelocityCommand", "VelocityInput", "Odometry", "PlatformVelocity"] {
        assert!(
            found.iter().any(|line| line.contains(&format!("{type_name}.v1 linear_m_s"))),
            "{type_name}: {found:?}"
        );
        assert!(
            found.iter().any(|line| line.contains(&format!("{type_name}.v1 schema hash"))),
            "{type_name}: {found:?}"
        );
    }
}
