//! Contract: the same samples give the same energyscape from `.npy`, `.npz` and `.wav`; axes travel with every export; a broken
//! file of any kind gives one clear sentence and exit 65.

use assert_cmd::Command;
use hound::{SampleFormat as Kind, WavSpec, WavWriter};
use noctule::config::Config;
use noctule::service::{simulator, wiring};
use noctule::signal::{SampleFormat, Samples};
use noctule::sim::{SimParams, World};
use noctule::time::Stamp;
use npyz::WriterBuilder as _;
use std::io::{Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

const MICS: usize = 32;
const RATE_HZ: u32 = 450_000;

/// A ping of a wall at 2 m, `[mic][sample]`.
fn ping() -> &'static [f32] {
    static PING: OnceLock<Vec<f32>> = OnceLock::new();
    PING.get_or_init(|| {
        let mut config = Config::default();
        config.sensor.truncate(1);
        config.recording.format = SampleFormat::PcmF32;
        let text = "[[wall]]\npoints = [[2.0, -3.0], [2.0, 3.0]]\n[start]\ncorner = [0.0, 0.0]\nsize = [0.0, 0.0]\n";
        let world = World::parse(Path::new("wall.toml"), text).expect("world");
        let setup = wiring::sensing(&config).expect("setup");
        let mut simulator = simulator(&config, &setup, world, SimParams::default(), 7).expect("simulator");
        let mut pings = simulator.empty_ping_set();
        simulator.ping_set(Stamp::default(), &mut pings);
        match &*pings.pings[0].samples {
            Samples::PcmF32(values) => values.clone(),
            other => panic!("{:?}", other.format()),
        }
    })
}

/// The same at each time one microphone after the other.
fn interleaved() -> impl Iterator<Item = f32> {
    let samples = ping().len() / MICS;
    (0..samples).flat_map(move |time| (0..MICS).map(move |mic| ping()[mic * samples + time]))
}

fn npy(values: &[f32]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let shape = [1, MICS as u64, (values.len() / MICS) as u64];
    let mut writer =
        npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut bytes).begin_nd().expect("npy");
    writer.extend(values.iter().copied()).expect("values");
    writer.finish().expect("end");
    bytes
}

fn npz(arrays: &[(&str, &[u8])], method: CompressionMethod) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method).large_file(true);
    for (name, bytes) in arrays {
        archive.start_file(format!("{name}.npy"), options).expect("entry");
        archive.write_all(bytes).expect("bytes");
    }
    archive.finish().expect("archive").into_inner()
}

fn wav(kind: Kind, bits: u16, rate_hz: u32, write: impl Fn(&mut WavWriter<&mut Cursor<Vec<u8>>>)) -> Vec<u8> {
    let spec = WavSpec { channels: MICS as u16, sample_rate: rate_hz, bits_per_sample: bits, sample_format: kind };
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut bytes, spec).expect("header");
    write(&mut writer);
    writer.finalize().expect("end");
    bytes.into_inner()
}

fn wav_f32(rate_hz: u32) -> Vec<u8> {
    wav(Kind::Float, 32, rate_hz, |writer| interleaved().for_each(|value| writer.write_sample(value).expect("sample")))
}

fn wav_integers(bits: u16) -> Vec<u8> {
    let scale = f64::from(2.0_f32.powi(i32::from(bits) - 1));
    let most = scale - 1.0;
    wav(Kind::Int, bits, RATE_HZ, |writer| {
        interleaved().for_each(|value| {
            let whole = (f64::from(value) * scale).round().clamp(-scale, most) as i32;
            writer.write_sample(whole).expect("sample");
        });
    })
}

struct Room(TempDir);

impl Room {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        std::fs::write(folder.path().join("robot.toml"), "[[sensor]]\nname = \"front\"\n").expect("written");
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, command: &str, input: &str, bytes: &[u8], more: &[&str]) -> std::process::Output {
        std::fs::write(self.path(input), bytes).expect("written");
        let mut program = Command::cargo_bin("noctule").expect("built");
        program.timeout(std::time::Duration::from_secs(60)).arg(command).arg(self.path(input));
        program.arg("--config").arg(self.path("robot.toml")).arg("--out").arg(self.path(&format!("out_{input}")));
        program.args(more).output().expect("runs")
    }

    /// Images a recording and gives the energyscape's values.
    fn image(&self, input: &str, bytes: &[u8]) -> Vec<f32> {
        let output = self.run("process", input, bytes, &["--backend", "cpu", "--jobs", "1"]);
        assert!(output.status.success(), "{input}: {}", String::from_utf8_lossy(&output.stderr));
        let file = std::fs::File::open(self.path(&format!("out_{input}/energyscape.npy"))).expect("result");
        npyz::NpyFile::new(file).expect("header").into_vec().expect("values")
    }
}

#[test]
fn the_same_samples_give_the_same_image_from_every_format() {
    let room = Room::new();
    let expected = room.image("a.npy", &npy(ping()));
    assert!(expected.iter().any(|value| *value > 0.01));
    assert_eq!(room.image("b.wav", &wav_f32(RATE_HZ)), expected, "f32 WAV, bit for bit");
    let stored = npz(&[("pings", &npy(ping())), ("sample_rate_hz", &npy(&[0.0; 32]))], CompressionMethod::Stored);
    assert_eq!(room.image("c.npz", &stored), expected, "stored archive");
    let deflated = npz(&[("whatever", &npy(ping()))], CompressionMethod::Deflated);
    assert_eq!(room.image("d.npz", &deflated), expected, "compressed archive");
    // Rounding to 24 bits is an error of 3.4e-8 rms a sample, which the image averages: measured 8.2e-9 at most, and 3.3e-7 for 16 bits.
    let largest = |found: Vec<f32>| found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let (of_24, of_32, of_16) = (
        largest(room.image("e.wav", &wav_integers(24))),
        largest(room.image("f.wav", &wav_integers(32))),
        largest(room.image("g.wav", &wav_integers(16))),
    );
    println!("largest differences: 24 bit {of_24:e}, 32 bit {of_32:e}, 16 bit {of_16:e}");
    assert!(of_24 < 1e-7 && of_32 < 1e-7, "{of_24} {of_32}");
    assert!(of_16 < 5e-6 && of_16 > of_24, "{of_16}: 16 bits are coarser");
}

#[test]
fn an_archive_carries_image_axes_and_meta_data() {
    let room = Room::new();
    let expected = room.image("a.npy", &npy(ping()));
    let output = room.run("process", "b.npy", &npy(ping()), &["--backend", "cpu", "--format", "npz"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let folder = room.path("out_b.npy");
    let mut archive =
        ZipArchive::new(std::fs::File::open(folder.join("energyscape.npz")).expect("there")).expect("zip");
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        archive.by_name(&format!("{name}.npy")).expect(name).read_to_end(&mut bytes).expect("whole");
        bytes
    };
    let image: Vec<f32> = npyz::NpyFile::new(&array("energyscape")[..]).expect("npy").into_vec().expect("values");
    assert_eq!(image, expected);
    for axis in ["directions_deg", "ranges_m"] {
        let beside = std::fs::read(room.path("out_a.npy").join(format!("{axis}.npy"))).expect("axis");
        assert_eq!(array(axis), beside, "{axis}");
    }
    let meta = array("meta");
    let start = meta.iter().position(|byte| *byte == b'\n').expect("header") + 1;
    let text: String = meta[start..].chunks_exact(4).map(|four| char::from(four[0])).collect();
    let meta: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((&meta["pings"], &meta["sensor"]), (&1.into(), &"front".into()));
    let mut left: Vec<String> = std::fs::read_dir(&folder)
        .expect("folder")
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    left.sort();
    assert_eq!(left, ["energyscape.npz", "meta.json"]);
    // What is finished is not done again, in this format either.
    let again = room.run(
        "process",
        "b.npy",
        &std::fs::read(room.path("b.npy")).expect("same"),
        &["--backend", "cpu", "--format", "npz"],
    );
    assert!(again.status.success());
    // And it can be plotted, as can the recording.
    for (input, picture) in [(folder, "energyscape_polar_00000.png"), (room.path("b.npy"), "heard_00000.png")] {
        let mut program = Command::cargo_bin("noctule").expect("built");
        program
            .arg("plot")
            .arg(input)
            .arg("--config")
            .arg(room.path("robot.toml"))
            .arg("--out")
            .arg(room.path("pictures"));
        program.assert().success();
        assert!(std::fs::read(room.path("pictures").join(picture)).expect("picture").starts_with(b"\x89PNG"));
    }
}

#[test]
fn a_broken_file_gives_one_sentence_and_65() {
    let room = Room::new();
    let good = wav_f32(RATE_HZ);
    let archive = npz(&[("pings", &npy(ping()))], CompressionMethod::Stored);
    let mut spoilt = archive.clone();
    let middle = spoilt.len() / 2;
    spoilt[middle] ^= 0x40;
    let eight_bits =
        wav(Kind::Int, 8, RATE_HZ, |writer| (0..64).for_each(|_| writer.write_sample(1_i8).expect("sample")));
    let two = npz(&[("left", &npy(ping())), ("right", &npy(ping()))], CompressionMethod::Stored);
    let cases: [(&str, &[u8], &str); 9] = [
        ("a.wav", b"RIFF and nothing else", "damaged"),
        ("b.wav", &good[..good.len() / 2], "truncated"),
        ("c.wav", &wav_f32(192_000), "found a sample rate of 192000 Hz, allowed: 450000 Hz"),
        ("d.wav", &eight_bits, "8 bits"),
        ("e.npz", b"PK and nothing else", "damaged archive"),
        ("f.npz", &archive[..archive.len() / 2], "damaged archive"),
        ("g.npz", &spoilt, "checksum"),
        ("h.npz", &two, "found arrays left, right, allowed: one array, or one of these names: pings"),
        ("i.wav", &[], "damaged"),
    ];
    for (name, bytes, expected) in cases {
        let output = room.run("process", name, bytes, &["--backend", "cpu"]);
        let talk = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(65), "{name}: {talk}");
        let told: Vec<&str> = talk.lines().filter(|line| line.starts_with("noctule: ")).collect();
        assert_eq!(told.len(), 1, "{name}: {talk}");
        assert!(told[0].contains(name) && told[0].contains(expected), "{name}: {talk}");
    }
}
