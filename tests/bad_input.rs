//! Contract: no bytes whatever, in no parser or decoder, panic, give an answer that is not sound, keep memory afterwards, or take
//! more of it than the input warrants. A plain run tries a thirtieth of 10^6 cases an entry, `NOCTULE_FULL=1` all.
//!
//! Cases are sound examples broken at random, with a fixed seed. A failing case is printed as bytes; `fuzz/` runs the same entries.

mod bad_input_entries;
mod checks;
mod common;

use bad_input_entries::{ENTRIES, Entry, NOW};
use checks::{figure, trials};
use common::Random;
use noctule::io::ros;
use noctule::io::wire::Checked as _;
use noctule::io::wire::message::{OperatorRequest, RawHeader, Request, VelocityCommand};
use noctule::signal::{DaemonState, Reason};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// Longest input that is made.
const INPUT_BYTES_MAX: usize = 4096;
/// What an entry may hold at once. Measured at most 9.4 bytes a byte of a table of numbers, 92 of a world, 96 of an npy header and
/// 111 of a configuration, whose errors draw the lines around the place, beside 24 KiB for tables of keys.
const BYTES_A_BYTE_MAX: usize = 400;
const BYTES_BESIDE_MAX: usize = 256 * 1024;
/// Least share of cases that are accepted in spite of what was broken in them, so that what is done with them is tried too.
const ACCEPTED_SHARE_MIN: f64 = 0.01;
/// Longest time of one case: an answer that takes longer is a hang. The longest measured is 9 ms.
const CASE_TIME_MAX: Duration = Duration::from_secs(2);

thread_local! {
    static LIVE_BYTES: Cell<i64> = const { Cell::new(0) };
    static PEAK_BYTES: Cell<i64> = const { Cell::new(0) };
}

/// Counts what each thread holds.
struct Counting;

fn count(change: i64) {
    // At the end of a thread its counters are gone; what it frees then is nobody's case.
    let _ = LIVE_BYTES.try_with(|live| {
        live.set(live.get() + change);
        let _ = PEAK_BYTES.try_with(|peak| peak.set(peak.get().max(live.get())));
    });
}

// SAFETY: every call goes unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as i64));
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What parsers stumble over.
const WORDS: &[&[u8]] = &[
    b"nan",
    b"inf",
    b"-inf",
    b"-0.0",
    b"0",
    b"-1",
    b"1e308",
    b"1e-320",
    b"1e999",
    b"9223372036854775807",
    b"18446744073709551616",
    b"0x7fffffff",
    b"true",
    b"\"\"",
    b"[]",
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"\"",
    b"'''",
    b"=",
    b",",
    b",,",
    b"#",
    b"\n",
    b"\r\n",
    b"\n\n[[sensor]]\nname = \"front\"\n",
    b"[ipc]\n",
    b"\0",
    b"\xff\xfe",
    b"\xe2\x80\xae",
    b"(18446744073709551615, 1)",
    b"(0,)",
    b"'>f8'",
    b"'|O'",
    b"True",
    b"../../../x",
    b"/dev/zero",
];

/// An example, broken at one to eight places.
fn broken(random: &mut Random, examples: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = examples[random.index(examples.len())].clone();
    for _ in 0..=random.index(8) {
        let at = random.index(bytes.len() + 1);
        let end = (at + random.index(24)).min(bytes.len());
        match random.index(9) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.index(8),
            1 if at < bytes.len() => bytes[at] = random.bits() as u8,
            2 => drop(bytes.splice(at..end, WORDS[random.index(WORDS.len())].iter().copied())),
            3 => drop(bytes.splice(at..at, WORDS[random.index(WORDS.len())].iter().copied())),
            4 => drop(bytes.drain(at..end)),
            5 => bytes.truncate(at),
            6 => {
                let piece: Vec<u8> = bytes[at..end].repeat(1 + random.index(4));
                drop(bytes.splice(at..at, piece));
            }
            7 => {
                let other = &examples[random.index(examples.len())];
                let from = random.index(other.len() + 1);
                let to = (from + random.index(64)).min(other.len());
                drop(bytes.splice(at..end, other[from..to].iter().copied()));
            }
            _ => {
                let number = random.bits().to_le_bytes();
                let end = (at + 1 + random.index(8)).min(bytes.len());
                bytes[at..end].copy_from_slice(&number[..end - at]);
            }
        }
    }
    bytes.truncate(INPUT_BYTES_MAX);
    bytes
}

/// Files of a folder that end in `extension`; long ones by pieces, since a short text is broken more thoroughly.
fn files(folder: &str, extension: &str) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{folder}: {error}"));
    let mut paths: Vec<_> = entries.map(|entry| entry.expect("entry").path()).collect();
    paths.sort();
    paths.retain(|path| path.extension().is_some_and(|found| found == extension));
    let texts = paths.iter().map(|path| std::fs::read(path).expect("readable"));
    texts.flat_map(|text| text.chunks(2000).map(<[u8]>::to_vec).collect::<Vec<_>>()).collect()
}

fn npy(descr: &str, shape: &str, values: usize) -> Vec<u8> {
    let dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{dict:117}\n").bytes());
    bytes.extend((0..values).map(|value| value as u8));
    bytes
}

fn encoded<T: serde::Serialize>(message: &T) -> Vec<u8> {
    let mut bytes = Vec::new();
    ros::encode_into(message, &mut bytes).expect("encoded");
    bytes
}

fn wrapped<T>(wire: T) -> ros::WireMessage<T> {
    ros::WireMessage { header: ros::Header::new(NOW.wall_ns, "base_link"), wire }
}

fn raw_ping() -> ros::RawPingMessage<'static> {
    let wire = RawHeader { sample_count: 16, channel_count: 1, ..RawHeader::blank() };
    ros::RawPingMessage { header: ros::Header::default(), wire, data: ros::Octets(&[7; 64]) }
}

/// A recording of three messages in two chunks.
fn recorded(compression: Option<mcap::Compression>) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(compression).emit_summary_records(false);
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).expect("begun");
    let command = VelocityCommand::standstill(NOW, DaemonState::Active, Reason::None);
    let messages = [
        ("/noctule/pipeline", encoded(&wrapped(ros::PipelineStep::blank()))),
        ("/noctule/command", encoded(&wrapped(command))),
        ("/noctule/sonar/front/raw", encoded(&raw_ping())),
    ];
    for (topic, bytes) in messages {
        let channel_id = writer.add_channel(0, topic, "cdr", &Default::default()).expect("channel");
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, &bytes).expect("written");
        writer.flush().expect("a chunk");
    }
    writer.finish().expect("finished");
    writer.into_inner().into_inner()
}

/// A WAV file of `bytes` bytes of samples.
fn wav(format: u16, bits: u16, channels: u16, bytes: u32) -> Vec<u8> {
    let block = channels * bits / 8;
    let mut file = [b"RIFF".as_slice(), &(36 + bytes).to_le_bytes(), b"WAVEfmt ", &16_u32.to_le_bytes()].concat();
    for number in [format, channels] {
        file.extend(number.to_le_bytes());
    }
    for number in [450_000, 450_000 * u32::from(block)] {
        file.extend(number.to_le_bytes());
    }
    for number in [block, bits] {
        file.extend(number.to_le_bytes());
    }
    file.extend([b"data".as_slice(), &bytes.to_le_bytes()].concat());
    file.extend((0..bytes).map(|value| value as u8));
    file
}

/// A NumPy archive of stored arrays.
fn npz(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    use std::io::Write as _;
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in arrays {
        archive.start_file(format!("{name}.npy"), options).expect("entry");
        archive.write_all(bytes).expect("bytes");
    }
    archive.finish().expect("archive").into_inner()
}

fn examples(name: &str) -> Vec<Vec<u8>> {
    let command = VelocityCommand::standstill(NOW, DaemonState::Active, Reason::None);
    match name {
        "config" => {
            // Sections of the complete example, each a whole document.
            let text = std::fs::read_to_string("fixtures/config/robot.toml").expect("readable");
            let mut found: Vec<Vec<u8>> = text.split("\n\n").map(|part| part.as_bytes().to_vec()).collect();
            found.extend(files("fixtures/config/broken", "toml"));
            found
        }
        "world" => files("fixtures/worlds", "toml"),
        "array_csv" => files("fixtures/arrays", "csv"),
        "emission_csv" => {
            let mut recorded = files("fixtures/emissions", "csv").swap_remove(0);
            recorded.truncate(500);
            vec![recorded, b"index,sample\n0,0.5\n1,-1\n2,1e-3\n".to_vec()]
        }
        "directions_csv" => vec![b"azimuth_deg,elevation_deg\n-90,0\n0,10.5\n45,-20\n90\n".to_vec()],
        "recording_npy" => vec![
            npy("<u4", "3, 8", 96),
            npy("<u4", "8,", 32),
            npy("<i2", "2, 3, 4", 48),
            npy("<f4", "3, 4", 48),
            npy("<f4", "2, 0, 4", 0),
        ],
        "recording_wav" => vec![wav(1, 16, 2, 64), wav(3, 32, 3, 96), wav(1, 24, 2, 60), wav(1, 32, 1, 32)],
        "recording_npz" => vec![
            npz(&[("pings", npy("<i2", "2, 3, 4", 48))]),
            npz(&[("arr_0", npy("<f4", "3, 4", 48)), ("axis", npy("<f8", "3,", 24))]),
        ],
        "recording_bin" => vec![vec![0, 4, 1, 2, 3, 4, 5, 6, 7, 8, 9], [vec![0, 2], vec![7; 64]].concat()],
        "recording_mcap" => [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)].map(recorded).to_vec(),
        "ros_message" => {
            let twist = |kind: u8, message: Vec<u8>| [vec![kind], message].concat();
            let image = ros::Image { encoding: "32FC1".to_owned(), data: ros::Octets(&[1; 64]), ..Default::default() };
            vec![
                twist(0, encoded(&wrapped(command))),
                twist(1, encoded(&wrapped(ros::PipelineStep::blank()))),
                twist(2, encoded(&raw_ping())),
                twist(3, encoded(&image)),
            ]
        }
        "raw_header" => {
            let header = RawHeader {
                sequence: 7,
                t_monotonic_ns: NOW.boottime_ns - 40_000_000,
                sample_rate_hz: 450e3,
                version: 1,
                sensor_index: 1,
                channel_count: 32,
                sample_count: 14_400,
                format: 1,
                ..RawHeader::blank()
            };
            vec![[bytemuck::bytes_of(&header), &(32 * 14_400_u32).to_le_bytes()].concat()]
        }
        "command" | "echo" => vec![bytemuck::bytes_of(&command.sealed()).to_vec()],
        "operator" => [Request::Arm, Request::Stop, Request::Reset]
            .map(|request| bytemuck::bytes_of(&OperatorRequest::new(request, 3, 1, NOW)).to_vec())
            .to_vec(),
        other => panic!("no examples for {other}"),
    }
}

/// Every other spoilt command and request gets a checksum that fits, so that what lies behind that test is met too.
fn reseal(name: &str, bytes: &mut [u8]) {
    let checksum = match name {
        "command" => VelocityCommand::CHECKSUM_OFFSET,
        "operator" => OperatorRequest::CHECKSUM_OFFSET,
        _ => return,
    };
    if bytes.len() >= checksum + 4 {
        let sum = crc32fast::hash(&bytes[..checksum]);
        bytes[checksum..checksum + 4].copy_from_slice(&sum.to_le_bytes());
    }
}

/// What was worst in a series of cases.
#[derive(Default)]
struct Worst {
    accepted: usize,
    peak_bytes: i64,
    time: Duration,
}

/// Time that this thread has computed: that of the clock on the wall is the machine's too.
fn processor_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Runs one case; the error says what was wrong with it.
fn judge(entry: &Entry, bytes: &[u8], worst: &mut Worst) -> Result<(), String> {
    let before = LIVE_BYTES.get();
    PEAK_BYTES.set(before);
    let begin = processor_time();
    let ended = catch_unwind(AssertUnwindSafe(|| (entry.run)(bytes)));
    let time = processor_time().saturating_sub(begin);
    let (peak_bytes, kept_bytes) = (PEAK_BYTES.get() - before, LIVE_BYTES.get() - before);
    match ended {
        Ok(accepted) => worst.accepted += usize::from(accepted),
        Err(panic) => {
            let said = panic.downcast_ref::<String>().cloned();
            let said = said.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            return Err(format!("panicked: {}", said.unwrap_or_default()));
        }
    }
    let allowed = (BYTES_BESIDE_MAX + BYTES_A_BYTE_MAX * bytes.len()) as i64;
    worst.peak_bytes = worst.peak_bytes.max(peak_bytes);
    worst.time = worst.time.max(time);
    if peak_bytes > allowed {
        return Err(format!("{peak_bytes} bytes for an input of {}", bytes.len()));
    }
    if kept_bytes > 0 {
        return Err(format!("{kept_bytes} bytes kept"));
    }
    if time > CASE_TIME_MAX {
        return Err(format!("took {time:?}"));
    }
    Ok(())
}

fn run(entry: &Entry, cases: usize) -> Result<Worst, String> {
    let examples = examples(entry.name);
    let mut random = Random(0x6e6f_6374);
    // Tables that are made at first use stay.
    for bytes in &examples {
        let _ = (entry.run)(bytes);
    }
    let mut worst = Worst::default();
    for number in 0..cases {
        let mut bytes = broken(&mut random, &examples);
        if number % 2 == 0 {
            reseal(entry.name, &mut bytes);
        }
        judge(entry, &bytes, &mut worst)
            .map_err(|found| format!("{} case {number} {found}: b\"{}\"", entry.name, bytes.escape_ascii()))?;
    }
    Ok(worst)
}

/// Runs an entry's cases and tells the figures under the number of its check.
fn check(number: u8, name: &str) {
    let entry = ENTRIES.iter().find(|entry| entry.name == name).expect("an entry of that name");
    let cases = trials(1_000_000, 1);
    let outcome = run(entry, cases);
    let bad = usize::from(outcome.is_err());
    figure(number, &format!("{name}: panics, unsound answers, memory beyond bounds"), bad, "0", cases);
    let worst = outcome.unwrap_or_else(|found| panic!("{found}"));
    let told = format!("{} KiB, {:.1} ms", worst.peak_bytes / 1024, worst.time.as_secs_f64() * 1e3);
    figure(number, &format!("{name}: most memory and longest time of a case"), told, "64 MiB", cases);
    // Of cases that are all refused at the first byte nothing would be learnt; of echo nothing is refused.
    let share = worst.accepted as f64 / cases as f64;
    println!("{name}: {:.1} % accepted", share * 100.0);
    assert!(share >= ACCEPTED_SHARE_MIN, "{name}: only {:.2} % of the cases were accepted", share * 100.0);
}

#[test]
fn no_bytes_break_the_configuration() {
    check(33, "config");
}

#[test]
fn no_bytes_break_a_world() {
    check(33, "world");
}

#[test]
fn no_bytes_break_a_table_of_microphones() {
    check(33, "array_csv");
}

#[test]
fn no_bytes_break_a_table_of_samples() {
    check(33, "emission_csv");
}

#[test]
fn no_bytes_break_a_table_of_directions() {
    check(33, "directions_csv");
}

#[test]
fn no_bytes_break_the_reading_of_npy() {
    check(21, "recording_npy");
}

#[test]
fn no_bytes_break_the_reading_of_wav() {
    check(21, "recording_wav");
}

#[test]
fn no_bytes_break_the_reading_of_npz() {
    check(21, "recording_npz");
}

#[test]
fn no_bytes_break_the_reading_of_bin() {
    check(21, "recording_bin");
}

#[test]
fn no_bytes_break_the_reading_of_mcap() {
    check(38, "recording_mcap");
}

#[test]
fn no_bytes_break_the_decoding_of_messages() {
    check(38, "ros_message");
}

#[test]
fn no_header_of_a_raw_ping_that_does_not_fit_is_taken() {
    check(21, "raw_header");
}

#[test]
fn no_bytes_on_the_command_topic_move_the_platform_beyond_its_limits() {
    check(8, "command");
}

#[test]
fn no_spoilt_request_arms_or_resets() {
    check(8, "operator");
}

#[test]
fn no_bytes_in_shared_memory_break_echo() {
    check(21, "echo");
}

#[test]
fn an_entry_without_a_test_would_be_noticed() {
    let source = include_str!("bad_input.rs");
    for entry in ENTRIES {
        assert!(source.contains(&format!(", \"{}\");\n", entry.name)), "{} is tried by no test", entry.name);
    }
}

/// Negative control: a decoder that believes a length, one that slices by it, one that keeps what it reads, and one that takes
/// everything are each found within a thousand cases.
#[test]
fn parsers_with_planted_faults_are_found() {
    fn length(bytes: &[u8]) -> usize {
        bytes.get(8..10).map_or(0, |two| usize::from(two[0]) | usize::from(two[1]) << 8)
    }
    let believes = |bytes: &[u8]| std::hint::black_box(vec![0_u8; length(bytes) << 8]).is_empty();
    let slices = |bytes: &[u8]| std::hint::black_box(bytes[..length(bytes)].to_vec()).is_empty();
    let keeps = |bytes: &[u8]| {
        std::mem::forget(std::hint::black_box(bytes.to_vec()));
        true
    };
    let takes_all = |bytes: &[u8]| {
        noctule::sensor::MicrophoneArray::from_csv(&String::from_utf8_lossy(bytes)).expect("always a table");
        true
    };
    let planted: [(&str, fn(&[u8]) -> bool, &str); 4] = [
        ("recording_npy", believes, "bytes for an input"),
        ("recording_npy", slices, "panicked"),
        ("recording_npy", keeps, "bytes kept"),
        ("array_csv", takes_all, "panicked"),
    ];
    let quiet = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let found: Vec<_> = planted
        .iter()
        .map(|(name, planted, _)| run(&Entry { name, run: *planted }, 1000).err().unwrap_or_default())
        .collect();
    std::panic::set_hook(quiet);
    for ((_, _, expected), found) in planted.iter().zip(found) {
        assert!(found.contains(expected), "{expected:?} is not in {found:?}");
    }
}
