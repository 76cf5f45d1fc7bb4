//! Contract: a bad configuration starts nothing and is refused in time, and a bad recording costs neither memory nor time nor
//! another recording; nothing is written outside the folder that was named. All with the program as it is installed.

mod checks;

use assert_cmd::cargo::CommandCargoExt as _;
use checks::figure;
use noctule::config::Config;
use noctule::service::wiring;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

const CHANNELS: usize = 32;
const SAMPLES: usize = 4096;
const MIB: u64 = 1024 * 1024;

/// How a process ended, and what it took.
struct Ended {
    output: Output,
    time: Duration,
    peak_bytes: u64,
}

impl Ended {
    fn code(&self) -> Option<i32> {
        self.output.status.code()
    }

    fn said(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }
}

/// Runs a command to its end and watches its memory; killed after `limit`, since a hang is what these tests look for.
fn run(command: &mut Command, limit: Duration) -> Ended {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let begin = Instant::now();
    let mut child = command.spawn().expect("started");
    let (mut out, mut err) = (child.stdout.take().expect("piped"), child.stderr.take().expect("piped"));
    let out = std::thread::spawn(move || drain(&mut out));
    let err = std::thread::spawn(move || drain(&mut err));
    let status_file = format!("/proc/{}/status", child.id());
    let mut peak_bytes = 0;
    let (status, time) = loop {
        peak_bytes = peak_bytes.max(peak_of(&status_file));
        if let Some(status) = child.try_wait().expect("watched") {
            break (status, begin.elapsed());
        }
        assert!(begin.elapsed() < limit || child.kill().is_err(), "{command:?} hangs");
        std::thread::sleep(Duration::from_micros(500));
    };
    let output = Output { status, stdout: out.join().expect("read"), stderr: err.join().expect("read") };
    Ended { output, time, peak_bytes }
}

fn drain(from: &mut impl std::io::Read) -> Vec<u8> {
    let mut bytes = Vec::new();
    from.read_to_end(&mut bytes).expect("read");
    bytes
}

/// Largest resident memory so far; 0 where the system does not tell.
fn peak_of(status_file: &str) -> u64 {
    let text = std::fs::read_to_string(status_file).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok()).unwrap_or(0) * 1024
}

fn noctule() -> Command {
    Command::cargo_bin("noctule").expect("the program is built")
}

/// A folder with a configuration of short PCM pings, and its own root for shared memory.
struct Room(tempfile::TempDir);

impl Room {
    fn new() -> Self {
        let room = Self(tempfile::tempdir().expect("folder"));
        let root = room.path("root");
        let text = format!(
            "config_version = 1\n[recording]\nformat = \"pcm-i16\"\nsamples = {SAMPLES}\n[imaging]\nrange_max_m = 1.1\n[ipc]\nroot = {root:?}\n"
        );
        std::fs::write(room.path("robot.toml"), text).expect("configuration");
        room
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        std::fs::write(&path, bytes).expect("written");
        path
    }

    fn process(&self, inputs: &[&Path], out: &str) -> Command {
        let mut command = noctule();
        command.current_dir(self.0.path()).arg("process").args(inputs).arg("--config").arg(self.path("robot.toml"));
        command.arg("--out").arg(out).args(["--backend", "cpu"]);
        command
    }
}

/// A header of version 2 for `shape`, with no more behind it than `bytes`.
fn npy(descr: &str, shape: &str, bytes: usize) -> Vec<u8> {
    let mut dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while !(dict.len() + 13).is_multiple_of(64) {
        dict.push(' ');
    }
    dict.push('\n');
    let mut file = b"\x93NUMPY\x02\x00".to_vec();
    file.extend((dict.len() as u32).to_le_bytes());
    file.extend(dict.bytes());
    file.extend((0..bytes).map(|index| (index * 31) as u8));
    file
}

/// A recorded run of one record that claims `length` bytes.
fn mcap(opcode: u8, length: u64, bytes: &[u8]) -> Vec<u8> {
    [b"\x89MCAP0\r\n".as_slice(), &[opcode], &length.to_le_bytes(), bytes].concat()
}

fn sound_recording() -> Vec<u8> {
    npy("<i2", &format!("(1, {CHANNELS}, {SAMPLES})"), CHANNELS * SAMPLES * 2)
}

#[test]
fn every_bad_configuration_ends_every_command_with_78_within_200_ms_and_starts_nothing() {
    let folder = std::fs::canonicalize("fixtures/config/broken").expect("folder");
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(&folder).expect("read").map(|it| it.expect("entry").path()).collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "toml"));
    let room = Room::new();
    let (mut slowest, mut wrong) = (Duration::ZERO, Vec::new());
    for (index, path) in files.iter().enumerate() {
        let text = std::fs::read_to_string(path).expect("read");
        let key = text.lines().find_map(|line| line.strip_prefix("# key:")).expect("a key").trim();
        // Three in turn: each file is one process, all commands read configurations by the same function.
        let commands: [&[&str]; 3] = [&["run", "--source", "sim"], &["controller"], &["simulate", "office"]];
        let words = commands[index % commands.len()];
        let mut command = noctule();
        command.args(words).arg("--config").arg(path).current_dir(room.0.path());
        command.env("XDG_RUNTIME_DIR", room.path("run")).env("TMPDIR", room.path("tmp"));
        let ended = run(&mut command, Duration::from_secs(10));
        slowest = slowest.max(ended.time);
        let last = key.rsplit('.').next().unwrap_or(key);
        if ended.code() != Some(78) || !ended.said().contains(last) {
            wrong.push(format!("{}: {:?}: {}", path.display(), ended.code(), ended.said()));
        }
    }
    let left: Vec<_> =
        std::fs::read_dir(room.0.path()).expect("read").map(|it| it.expect("entry").file_name()).collect();
    figure(33, "bad configurations that did not end with 78 naming the key", wrong.len(), "0 of 60", files.len());
    figure(33, "slowest refusal of a configuration", format!("{} ms", slowest.as_millis()), "<= 200 ms", files.len());
    assert!(files.len() >= 60, "{} files", files.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(left, ["robot.toml"], "something was started");
    assert!(slowest <= Duration::from_millis(200), "{slowest:?}");
}

/// Negative control of the test above: a sound configuration does start, and is seen to.
#[test]
fn a_good_configuration_starts_and_leaves_its_root() {
    let room = Room::new();
    let mut command = noctule();
    command.args(["run", "--source", "live", "--duration", "0.1", "--config"]).arg(room.path("robot.toml"));
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("started");
    let begin = Instant::now();
    while !room.path("root").exists() && begin.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().and_then(|()| child.wait()).expect("ended");
    let prefix = Config::load(&room.path("robot.toml")).expect("sound").ipc.prefix;
    assert!(room.path("root").exists(), "nothing was started");
    drop(prefix);
}

#[test]
fn recordings_that_claim_the_impossible_end_with_65_in_time_and_without_memory() {
    let room = Room::new();
    let huge = u64::MAX / 2;
    let bombs: Vec<(&str, Vec<u8>)> = vec![
        ("pings.npy", npy("<i2", &format!("({huge}, {CHANNELS}, {SAMPLES})"), 64)),
        ("microphones.npy", npy("<i2", &format!("(1, {huge}, {SAMPLES})"), 64)),
        ("samples.npy", npy("<i2", &format!("(1, {CHANNELS}, {huge})"), 64)),
        ("all.npy", npy("<f4", &format!("({huge}, {huge}, {huge})"), 64)),
        ("product_of_zero.npy", npy("<f4", "(4294967296, 4294967296, 4294967296)", 64)),
        ("beyond_64_bits.npy", npy("<f4", "(1, 36893488147419103232, 2)", 64)),
        ("no_microphones.npy", npy("<i2", &format!("(1, 0, {SAMPLES})"), 64)),
        ("negative.npy", npy("<i2", &format!("(1, -32, {SAMPLES})"), 64)),
        ("header.npy", [&b"\x93NUMPY\x02\x00\xff\xff\xff\xff"[..], &[b' '; 64]].concat()),
        ("nested.npy", npy("<i2", &format!("({}1{})", "(".repeat(20_000), ")".repeat(20_000)), 64)),
        ("cut.npy", npy("<i2", &format!("(1, {CHANNELS}, {SAMPLES})"), 1000)),
        ("words.bin", vec![1; 1000]),
        ("object.npy", npy("|O", "(1,)", 64)),
        ("record.mcap", mcap(5, u64::MAX, &[0; 64])),
        ("message.mcap", mcap(5, 1 << 40, &[0; 64])),
        ("chunk.mcap", mcap(6, 100, &[[0; 16].as_slice(), &[0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0], &[0; 76]].concat())),
        ("strings.mcap", mcap(4, 8, &[1, 0, 0, 0, 0xff, 0xff, 0xff, 0x7f])),
        ("magic.mcap", b"\x89MCAP0\r\n".to_vec()),
        ("empty.mcap", Vec::new()),
        ("empty.npy", Vec::new()),
        ("empty.bin", Vec::new()),
    ];
    let (mut slowest, mut largest) = (Duration::ZERO, 0);
    let mut wrong = Vec::new();
    for (index, (name, bytes)) in bombs.iter().enumerate() {
        let path = room.file(name, bytes);
        let ended = run(&mut room.process(&[&path], &format!("out{index}")), Duration::from_secs(20));
        (slowest, largest) = (slowest.max(ended.time), largest.max(ended.peak_bytes));
        if ended.code() != Some(65) || !ended.said().contains(name) {
            wrong.push(format!("{name}: {:?}: {}", ended.code(), ended.said()));
        }
    }
    figure(38, "recordings that claim the impossible and did not end with 65", wrong.len(), "0", bombs.len());
    figure(38, "slowest refusal of a recording", format!("{} ms", slowest.as_millis()), "<= 2 s", bombs.len());
    figure(38, "most memory", format!("{} MiB", largest / MIB), "<= 256 MiB", bombs.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(slowest <= Duration::from_secs(2), "{slowest:?}");
    assert!(largest > 0 && largest <= 256 * MIB, "{largest} bytes");
}

#[test]
fn devices_pipes_folders_and_links_to_nowhere_are_refused_and_do_not_stop_the_others() {
    let room = Room::new();
    let good = room.file("in/good.npy", &sound_recording());
    for (name, target) in [("zero.npy", "/dev/zero"), ("full.bin", "/dev/full"), ("nowhere.npy", "/nonexistent/file")] {
        std::os::unix::fs::symlink(target, room.path("in").join(name)).expect("link");
    }
    std::os::unix::fs::symlink("loop.npy", room.path("in/loop.npy")).expect("link");
    // Opening a pipe that nobody writes to would wait for ever.
    let made = Command::new("mkfifo").arg(room.path("in/pipe.npy")).status().expect("mkfifo runs");
    assert!(made.success());
    let names = ["zero.npy", "full.bin", "nowhere.npy", "loop.npy", "pipe.npy"];
    let inputs: Vec<PathBuf> = names.iter().map(|name| room.path("in").join(name)).collect();
    let all: Vec<&Path> = inputs.iter().map(PathBuf::as_path).chain([good.as_path()]).collect();
    let ended = run(&mut room.process(&all, "out"), Duration::from_secs(20));
    let said = ended.said();
    let unnamed: Vec<_> = names.iter().filter(|name| !said.contains(*name)).collect();
    figure(38, "devices, pipes, links and loops not named", unnamed.len(), "0", names.len());
    assert!(unnamed.is_empty(), "{unnamed:?} in {said}");
    assert_eq!(ended.code(), Some(65), "{said}");
    assert!(room.path("out/good/energyscape.npy").exists(), "the good one is imaged: {said}");
}

#[test]
fn names_of_recordings_lead_nowhere_but_into_the_folder_for_results() {
    let room = Room::new();
    room.file("deep/in/a.npy", &sound_recording());
    room.file("deep/in/...npy", &sound_recording());
    room.file("deep/in/..\\evil.npy", &sound_recording());
    room.file("deep/in/-rf.npy", &sound_recording());
    room.file("deep/in/\u{202e}gpj.npy", &sound_recording());
    let before = files_of(room.0.path());
    let inputs = [room.path("deep/in/../in/a.npy"), room.path("deep/in/..\\evil.npy"), room.path("deep/in/-rf.npy")];
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let ended = run(&mut room.process(&inputs, "deep/out"), Duration::from_secs(20));
    assert_eq!(ended.code(), Some(0), "{}", ended.said());
    // The whole folder, names with dots and control characters among it.
    let ended = run(&mut room.process(&[&room.path("deep/in")], "deep/all"), Duration::from_secs(20));
    assert!(matches!(ended.code(), Some(0 | 2 | 65)), "{:?} {}", ended.code(), ended.said());
    let after = files_of(room.0.path());
    let new: Vec<_> = after.iter().filter(|path| !before.contains(path)).collect();
    let outside: Vec<_> = new.iter().filter(|path| !is_below(path, &room, &["deep/out", "deep/all"])).collect();
    figure(38, "files written outside the folder for results", outside.len(), "0", new.len());
    assert!(outside.is_empty(), "{outside:?}");
    assert!(!new.is_empty(), "something was written");
    // Negative control: the same judgement sees a file that does lie elsewhere.
    assert!(!is_below(&room.file("deep/escaped.npy", b""), &room, &["deep/out", "deep/all"]));
}

fn is_below(path: &Path, room: &Room, folders: &[&str]) -> bool {
    folders.iter().any(|folder| path.starts_with(room.path(folder)))
}

fn files_of(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("read") {
        let path = entry.expect("entry").path();
        if path.is_dir() { found.extend(files_of(&path)) } else { found.push(path) }
    }
    found
}

/// What a configuration accepts can be planned, or is refused by name: no panic behind the validation.
#[test]
fn configurations_at_the_ends_of_their_ranges_are_planned_or_refused_by_name() {
    let ends = [
        "[imaging]\nrange_max_m = 0.3001\n",
        "[imaging]\nrange_min_m = 0.0\n",
        "[imaging]\nrange_step_m = 1.0\n",
        "[imaging.directions]\ncount = 1\n",
        "[imaging.directions]\ncount = 2\nstart_deg = -90.0\nstep_deg = 180.0\n",
        "[imaging]\nsmoothing_hz = 1e-3\n",
        "[imaging]\nsmoothing_hz = 1e9\n",
        "[emission]\nduration_s = 1e-5\n",
        "[emission]\nduration_s = 0.1\n",
        "[emission]\nstart_hz = 1.0\nend_hz = 2.0\n",
        "[recording]\nformat = \"pcm-f32\"\nsamples = 2\n",
        "[recording]\nformat = \"pcm-f32\"\nsample_rate_hz = 1e7\nsamples = 300000\n",
        "[recording]\nformat = \"pdm\"\nsamples = 64\n",
        "[platform]\nradius_m = 5.0\n",
        "[platform]\nradius_m = 1e-9\n",
        "[platform]\nmax_linear_m_s = 1e-9\n",
        "air_temperature_c = -50.0\n",
        "[control]\nrate_hz = 1.0\n",
        "[control]\nrate_hz = 100.0\n",
        "[control.energy]\nspreading_exponent = 0.0\n",
    ];
    let mut planned = 0;
    for text in ends {
        let Ok(config) = Config::parse(text, Path::new("robot.toml")) else { continue };
        let begin = Instant::now();
        let sensing = wiring::sensing(&config);
        assert!(begin.elapsed() < Duration::from_secs(5), "{text}: takes {:?} to plan or refuse", begin.elapsed());
        match sensing {
            Ok(setup) => {
                planned += 1;
                if let Err(error) = wiring::masks(&config, &setup) {
                    assert!(!error.key.is_empty() && !error.allowed.is_empty(), "{text}: {error:?}");
                }
            }
            Err(error) => assert!(!error.key.is_empty() && !error.allowed.is_empty(), "{text}: {error:?}"),
        }
    }
    assert!(planned >= 8, "only {planned} of {} are planned at all", ends.len());
}

/// The memory that is watched is the child's: a child that takes 300 MiB is seen to.
#[test]
fn memory_that_is_taken_would_be_noticed() {
    let mut command = Command::new("python3");
    command.args(["-c", "x = bytearray(300 << 20); print(len(x))"]);
    if Command::new("python3").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err() {
        let mut sink = std::io::stderr();
        writeln!(sink, "left out: there is no python3 to take memory").expect("written");
        return;
    }
    let ended = run(&mut command, Duration::from_secs(20));
    assert!(ended.peak_bytes > 256 * MIB, "{} bytes", ended.peak_bytes);
}
