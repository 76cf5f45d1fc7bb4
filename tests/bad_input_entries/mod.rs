//! Every way in for bytes that somebody else made, as a function of those bytes: configuration, world, tables, recordings, raw
//! pings, commands, requests. The property tests (`tests/bad_input.rs`) and the fuzz targets (`fuzz/`) run the same functions.
//!
//! An entry panics when its parser does, or when it breaks its word: an error says what was found and what is allowed, and what
//! was accepted is sound.
#![allow(dead_code, reason = "tests and fuzz targets use another part each")]

use noctule::config::Config;
use noctule::document::DocumentError;
use noctule::imaging::steering;
use noctule::io::RawShape;
use noctule::io::record::{Entry as RunEntry, RecordError, RunReader};
use noctule::io::recording_file::{RecordingError, RecordingFile};
use noctule::io::ros::{self, Image, PipelineStep, RawPingMessage, WireMessage};
use noctule::io::wire::message::{Odometry, OperatorRequest, RawHeader, Request, VelocityCommand, VelocityInput};
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::io::wire::{Checked, WireType, fields_json};
use noctule::parameter::ParameterError;
use noctule::safety::{CommandSample, Gate, GateEvent, GateParams, GateState, MotionLimits, OperatorEvent};
use noctule::sensor::{Emission, MicrophoneArray};
use noctule::signal::{SampleFormat, Samples};
use noctule::sim::World;
use noctule::time::Stamp;
use std::path::Path;

/// An entry: its name, and what it does with bytes; true when they were accepted.
#[derive(Clone, Copy)]
pub struct Entry {
    pub name: &'static str,
    pub run: fn(&[u8]) -> bool,
}

pub const ENTRIES: &[Entry] = &[
    Entry { name: "config", run: config },
    Entry { name: "world", run: world },
    Entry { name: "array_csv", run: array_csv },
    Entry { name: "emission_csv", run: emission_csv },
    Entry { name: "directions_csv", run: directions_csv },
    Entry { name: "recording_npy", run: recording_npy },
    Entry { name: "recording_bin", run: recording_bin },
    Entry { name: "recording_mcap", run: recording_mcap },
    Entry { name: "ros_message", run: ros_message },
    Entry { name: "recording_wav", run: recording_wav },
    Entry { name: "recording_npz", run: recording_npz },
    Entry { name: "raw_header", run: raw_header },
    Entry { name: "command", run: command },
    Entry { name: "operator", run: operator },
    Entry { name: "echo", run: echo },
];

/// Runs the entry of that name.
pub fn run(name: &str, bytes: &[u8]) -> bool {
    let entry = ENTRIES.iter().find(|entry| entry.name == name);
    (entry.unwrap_or_else(|| panic!("no entry {name}")).run)(bytes)
}

/// When everything happens, on the boot-time clock.
pub const NOW: Stamp = Stamp { boottime_ns: 5_000_000_000_000, wall_ns: 0 };
const LINEAR_MAX_M_S: f64 = 0.3;
const ANGULAR_MAX_RAD_S: f64 = 1.0;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A refused document; never accepted.
fn says_what(error: &DocumentError) -> bool {
    assert!(error.rendered.contains("robot.toml"), "no file named: {error}");
    assert!(!error.summary.is_empty(), "nothing said: {error}");
    false
}

/// A refused table; never accepted.
fn names_found_and_allowed(error: &ParameterError) -> bool {
    assert!(!error.found.is_empty() && !error.allowed.is_empty(), "{error:?}");
    false
}

fn config(bytes: &[u8]) -> bool {
    match Config::parse(&text(bytes), Path::new("robot.toml")) {
        Ok(config) => {
            config.validate().expect("what was accepted is allowed");
            let gate = config.gate_params();
            assert!((1..=1_000_000_000).contains(&gate.max_age_ns), "a timeout of {} ns", gate.max_age_ns);
            let again = Config::parse(&config.to_toml(), Path::new("robot.toml"));
            let again = again.unwrap_or_else(|error| panic!("written and not read again: {error}"));
            assert_eq!(again, config, "written and read again");
            true
        }
        Err(error) => says_what(&error),
    }
}

fn world(bytes: &[u8]) -> bool {
    match World::parse(Path::new("robot.toml"), &text(bytes)) {
        Ok(world) => {
            for time_s in [0.0, 1.0, 1e6] {
                let finite = world.movers.iter().all(|mover| {
                    let position_m = mover.position_m(time_s);
                    position_m.x.is_finite() && position_m.y.is_finite()
                });
                assert!(finite, "a mover at no place after {time_s} s");
                assert!(world.outline(time_s).count() < 1 << 20);
            }
            true
        }
        Err(error) => says_what(&error),
    }
}

fn array_csv(bytes: &[u8]) -> bool {
    match MicrophoneArray::from_csv(&text(bytes)) {
        Ok(array) => {
            let count = array.channel_count();
            assert!(count > 0 && array.enabled.len() == count && array.weights.len() == count);
            assert!(array.positions_m.iter().all(|position_m| position_m.iter().all(|metres| metres.is_finite())));
            assert!(array.weights.iter().all(|weight| *weight >= 0.0 && weight.is_finite()));
            true
        }
        Err(error) => names_found_and_allowed(&error),
    }
}

fn emission_csv(bytes: &[u8]) -> bool {
    match Emission::from_csv(&text(bytes), 450e3, (25e3, 50e3)) {
        Ok(emission) => {
            assert!(emission.samples.len() >= 2 && emission.samples.iter().all(|value| value.is_finite()));
            true
        }
        Err(error) => names_found_and_allowed(&error),
    }
}

fn directions_csv(bytes: &[u8]) -> bool {
    match steering::directions_from_csv(&text(bytes)) {
        Ok(directions) => {
            assert!(!directions.is_empty());
            let finite = directions.iter().all(|it| it.azimuth_rad.is_finite() && it.elevation_rad.is_finite());
            assert!(finite, "a direction that is none");
            true
        }
        Err(error) => names_found_and_allowed(&error),
    }
}

fn recording_npy(bytes: &[u8]) -> bool {
    recording(Path::new("recording.npy"), bytes, 64)
}

/// The first two bytes are the words of a ping, as a configuration may say.
fn recording_bin(bytes: &[u8]) -> bool {
    let (words, rest) = bytes.split_at(bytes.len().min(2));
    recording(Path::new("recording.bin"), rest, words.iter().fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
}

fn recording_wav(bytes: &[u8]) -> bool {
    recording(Path::new("recording.wav"), bytes, 64)
}

fn recording_npz(bytes: &[u8]) -> bool {
    judge_recording(RecordingFile::from_archive(Path::new("recording.npz"), std::io::Cursor::new(bytes)), usize::MAX)
}

fn recording(path: &Path, bytes: &[u8], words_per_ping: usize) -> bool {
    let opened = RecordingFile::from_reader(path, bytes, bytes.len() as u64, words_per_ping);
    judge_recording(opened, bytes.len())
}

/// Reads all pings, of which there cannot be more than `count_max`.
fn judge_recording<R: std::io::Read>(opened: Result<RecordingFile<R>, RecordingError>, count_max: usize) -> bool {
    let refused = |error: RecordingError| {
        let message = error.to_string();
        assert!(message.contains("recording."), "no file named: {message}");
        assert!(message.contains("found") || matches!(error, RecordingError::Io { .. }), "{message}");
        false
    };
    let mut recording = match opened {
        Ok(recording) => recording,
        Err(error) => return refused(error),
    };
    let shape = recording.shape();
    let mut samples = Samples::zeros(shape.format, 0);
    let mut count = 0_usize;
    loop {
        match recording.read_ping(&mut samples) {
            Ok(false) => break,
            Ok(true) => {
                count += 1;
                assert_eq!(samples.len(), shape.sample_count * shape.channel_count.unwrap_or(1));
                assert!(count <= count_max, "{count} pings of {count_max} bytes");
            }
            Err(error) => return refused(error),
        }
    }
    assert_eq!(count, shape.ping_count);
    true
}

/// A recorded run: what is cut off gives what is whole, what is damaged is refused with the file's name.
fn recording_mcap(bytes: &[u8]) -> bool {
    let refused = |error: RecordError| {
        let message = error.to_string();
        assert!(message.contains("recording.mcap") && message.contains("found"), "{message}");
        false
    };
    let mut reader = match RunReader::from_reader(Path::new("recording.mcap"), bytes, bytes.len() as u64) {
        Ok(reader) => reader,
        Err(error) => return refused(error),
    };
    let mut count = 0_usize;
    loop {
        match reader.next_entry_of_part() {
            Ok(None) => break,
            Ok(Some(entry)) => {
                count += 1;
                // A message has eleven bytes beside its data, and no compression makes more than 255 of one.
                assert!(count <= bytes.len() * 255, "{count} entries of {} bytes", bytes.len());
                if let RunEntry::Raw(_, ping) = entry {
                    assert!(ping.data.0.len() <= bytes.len() * 255);
                }
            }
            Err(error) => return refused(error),
        }
    }
    assert!(reader.cut().is_none_or(|cut| cut.whole_bytes + cut.lost_bytes == bytes.len() as u64));
    true
}

/// The first byte says which message the rest is to be.
fn ros_message(bytes: &[u8]) -> bool {
    let Some((kind, rest)) = bytes.split_first() else { return false };
    fn wire_is<T: WireType>(bytes: &[u8]) -> bool {
        ros::decode::<WireMessage<T>>(bytes).is_ok_and(|message| message.checked().is_ok())
    }
    match kind % 4 {
        0 => wire_is::<VelocityCommand>(rest),
        1 => wire_is::<PipelineStep>(rest),
        2 => ros::decode::<RawPingMessage<'_>>(rest).is_ok_and(|ping| ping.data.0.len() <= rest.len()),
        _ => ros::decode::<Image<'_>>(rest).is_ok_and(|image| image.data.0.len() <= rest.len()),
    }
}

/// A value of a wire type from the first bytes, zeros where they are too few.
fn wire<T: WireType>(bytes: &[u8]) -> T {
    let mut value = T::default();
    let target = bytemuck::bytes_of_mut(&mut value);
    let count = target.len().min(bytes.len());
    target[..count].copy_from_slice(&bytes[..count]);
    value
}

/// The last four bytes are the number of values that came with the header.
fn raw_header(bytes: &[u8]) -> bool {
    let shape =
        RawShape { format: SampleFormat::PcmI16, sample_rate_hz: 450e3, channel_count: 32, sample_count: 14_400 };
    let header: RawHeader = wire(bytes);
    let count = bytes.last_chunk().map_or(0, |last| u32::from_le_bytes(*last) as usize);
    match shape.check(1, &header, count, NOW) {
        Ok(()) => {
            assert_eq!((count, header.sensor_index, header.format), (shape.len(), 1, 1));
            assert_eq!((header.channel_count, header.sample_count), (32, 14_400));
            assert_eq!(header.sample_rate_hz.to_bits(), 450e3_f64.to_bits());
            let age_ns = i128::from(NOW.boottime_ns) - i128::from(header.t_monotonic_ns);
            assert!((-50_000_000..=1_000_000_000).contains(&age_ns), "{age_ns} ns old");
            true
        }
        Err(refusal) => {
            assert!(refusal.to_string().len() > 10, "{refusal}");
            false
        }
    }
}

/// Bytes on the command topic, at a gate that tracks another publisher of the same epoch: nothing moves the platform beyond its
/// limits, and nothing that is not whole moves it at all.
fn command(bytes: &[u8]) -> bool {
    let command: VelocityCommand = wire(bytes);
    let limits = MotionLimits {
        linear_m_s: LINEAR_MAX_M_S,
        angular_rad_s: ANGULAR_MAX_RAD_S,
        linear_m_s2: 1.0,
        angular_rad_s2: 3.0,
    };
    let params = GateParams { max_age_ns: 300_000_000, hold_latch_ns: 10_000_000_000, limits };
    let mut gate = Gate::new(params, NOW);
    let mut now = NOW.plus_ns(1_000_000);
    let arm = OperatorEvent::Arm { epoch: command.epoch, requested_at_ns: now.boottime_ns };
    gate = gate.step(GateEvent::Operator(arm), now).0;
    let sound = command.schema_matches() && command.checksum_matches();
    for sequence in 0..6 {
        let sample = CommandSample {
            schema_matches: command.schema_matches(),
            checksum_matches: command.checksum_matches(),
            epoch: command.epoch,
            publisher: (command.publisher_id, 1),
            sequence: command.sequence.wrapping_add(sequence),
            captured_at_ns: command.t_monotonic_ns,
            valid_until_ns: command.valid_until_ns,
            velocity: command.velocity(),
            daemon_state: command.daemon_state(),
        };
        gate = gate.step(GateEvent::Command(sample), now).0;
        now = now.plus_ns(20_000_000);
        let (next, output) = gate.step(GateEvent::Tick, now);
        gate = next;
        let velocity = output.velocity;
        assert!(velocity.linear_m_s.abs() <= LINEAR_MAX_M_S && velocity.angular_rad_s.abs() <= ANGULAR_MAX_RAD_S);
        assert!(sound || output.state != GateState::Track, "a spoilt command was followed");
    }
    gate.state() == GateState::Track
}

fn operator(bytes: &[u8]) -> bool {
    let request: OperatorRequest = wire(bytes);
    // A stop counts whatever else is spoilt; anything that may lead to motion must be whole.
    let asked = request.request();
    if let Some(Request::Arm | Request::Reset) = asked {
        assert!(request.schema_matches() && request.checksum_matches());
    }
    let input: VelocityInput = wire(bytes);
    let wanted = input.wanted(NOW, 300_000_000);
    assert!(wanted.is_finite(), "{wanted:?}");
    asked.is_some()
}

/// `noctule echo` of whatever lies in shared memory.
fn echo(bytes: &[u8]) -> bool {
    for fields in [
        RawHeader::FIELDS,
        VelocityCommand::FIELDS,
        OperatorRequest::FIELDS,
        Odometry::FIELDS,
        Cues::FIELDS,
        PlatformVelocity::FIELDS,
        Health::FIELDS,
    ] {
        let object = fields_json(fields, bytes);
        assert_eq!(object.len(), fields.len());
        serde_json::to_string(&object).expect("JSON whatever the bytes are");
    }
    true
}
