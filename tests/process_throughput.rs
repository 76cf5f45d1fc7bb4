//! Contract: `process` over many recordings gives the same bytes however it is cut up, interrupted or run again, does nothing
//! twice, and needs no more memory for a longer recording.

mod checks;

use assert_cmd::cargo::CommandCargoExt as _;
use checks::{figure, trials};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const CHANNELS: usize = 32;
const SAMPLES: usize = 4096;

/// A folder with recordings of short PCM pings and the configuration that fits them.
struct Room(TempDir);

impl Room {
    fn new() -> Self {
        let room = Self(tempfile::tempdir().expect("folder"));
        std::fs::create_dir(room.path("in")).expect("folder");
        room.config("");
        room
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn config(&self, more: &str) {
        let text = format!(
            "config_version = 1\n[recording]\nformat = \"pcm-i16\"\nsamples = {SAMPLES}\n[imaging]\nrange_max_m = 1.1\n{more}\n"
        );
        std::fs::write(self.path("robot.toml"), text).expect("configuration");
    }

    /// A recording of noise that differs from ping to ping; two channels are stuck, so that every ping has something to tell.
    fn recording(&self, name: &str, pings: usize, seed: u32) -> PathBuf {
        let path = self.path("in").join(name);
        let mut file = std::io::BufWriter::new(std::fs::File::create(&path).expect("file"));
        let dict = format!("{{'descr': '<i2', 'fortran_order': False, 'shape': ({pings}, {CHANNELS}, {SAMPLES}), }}");
        file.write_all(b"\x93NUMPY\x01\x00\x76\x00").expect("written");
        file.write_all(format!("{dict:117}\n").as_bytes()).expect("written");
        let mut state = seed;
        let mut bytes = vec![0_u8; CHANNELS * SAMPLES * 2];
        for ping in 0..pings {
            // One new block of noise for some pings, shifted for the others: making it must not take the time of the test.
            if ping % 16 == 0 {
                for pair in bytes[2 * SAMPLES * 2..].chunks_exact_mut(2) {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    pair.copy_from_slice(&((state >> 19) as i16 - 4096).to_le_bytes());
                }
            }
            bytes[2 * SAMPLES * 2..].rotate_right(2);
            file.write_all(&bytes).expect("written");
        }
        file.flush().expect("written");
        path
    }

    fn process(&self, inputs: &[PathBuf], out: &str, more: &[&str]) -> Command {
        let mut command = Command::cargo_bin("noctule").expect("the program is built");
        command.arg("process").args(inputs).arg("--config").arg(self.path("robot.toml"));
        command.arg("--out").arg(self.path(out)).args(["--backend", "cpu"]).args(more);
        command
    }

    fn run(&self, inputs: &[PathBuf], out: &str, more: &[&str]) -> Output {
        self.process(inputs, out, more).output().expect("runs")
    }

    fn all(&self) -> [PathBuf; 1] {
        [self.path("in")]
    }
}

fn talk(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Every file below a folder, by its path within.
fn tree(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("folder").flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else {
                let within = entry.path().strip_prefix(folder).expect("below").to_owned();
                files.insert(within, std::fs::read(entry.path()).expect("file"));
            }
        }
    }
    files
}

fn assert_same(one: &Path, other: &Path) {
    let (one, other) = (tree(one), tree(other));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(*bytes == other[name], "{} differs", name.display());
    }
}

fn meta(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("meta.json")).expect("meta")).expect("JSON")
}

#[test]
fn killed_in_the_middle_and_run_again_gives_the_bytes_of_one_run() {
    let room = Room::new();
    for index in 0..4 {
        room.recording(&format!("{index}.npy"), 12, index);
    }
    let more = ["--png", "--jobs", "2"];
    assert!(room.run(&room.all(), "whole", &more).status.success());
    let mut command = room.process(&room.all(), "cut", &more);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
    let limit = Instant::now() + Duration::from_secs(60);
    // One or more finished and others begun: the pictures take long enough to be met on the way.
    let finished = || (0..4).filter(|index| room.path(&format!("cut/{index}/meta.json")).exists()).count();
    let begun = || (0..4).any(|index| room.path(&format!("cut/{index}/energyscape.npy.partial")).exists());
    while finished() == 0 || !begun() {
        assert!(Instant::now() < limit && child.try_wait().expect("child").is_none(), "met too late");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().expect("killed");
    child.wait().expect("gone");
    assert!(begun() && (1..=3).contains(&finished()), "{} of 4 finished", finished());
    let before = finished();
    let again = room.run(&room.all(), "cut", &more);
    assert!(again.status.success(), "{}", talk(&again));
    assert!(talk(&again).contains(&format!("{before} finished before, {} to do", 4 - before)), "{}", talk(&again));
    assert_same(&room.path("whole"), &room.path("cut"));
    let idle = room.run(&room.all(), "cut", &more);
    assert!(idle.status.success() && talk(&idle).contains("4 finished before, 0 to do"), "{}", talk(&idle));
    assert_eq!(talk(&idle).matches("skipped").count(), 4, "{}", talk(&idle));
}

/// Whether what a killed run left of one recording is either told to be unfinished, by having no `meta.json`, or has every byte of
/// a whole run.
fn is_unfinished_or_whole(left: &Path, whole: &Path) -> bool {
    !left.join("meta.json").exists() || {
        let (left, whole) = (tree(left), tree(whole));
        whole.iter().all(|(name, bytes)| left.get(name) == Some(bytes))
    }
}

#[test]
fn a_kill_at_any_moment_leaves_whole_results_or_none_and_the_next_run_completes_them() {
    let room = Room::new();
    for index in 0..3 {
        room.recording(&format!("{index}.npy"), 8, index);
    }
    let begin = Instant::now();
    assert!(room.run(&room.all(), "whole", &["--jobs", "2"]).status.success());
    let duration = begin.elapsed();
    let kills = trials(100, 4);
    let (mut torn, mut lost, mut met) = (0, 0, 0);
    for kill in 0..kills {
        let out = format!("cut{kill}");
        let mut command = room.process(&room.all(), &out, &["--jobs", "2"]);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
        // Evenly over the whole run, in an order that a plain run cuts short without losing either end.
        std::thread::sleep(duration.mul_f64((kill * 37 % 100) as f64 / 100.0));
        met += usize::from(child.try_wait().expect("child").is_none());
        child.kill().and_then(|()| child.wait()).expect("gone");
        let folder = |root: &str, index: usize| room.path(&format!("{root}/{index}"));
        torn += (0..3).filter(|index| !is_unfinished_or_whole(&folder(&out, *index), &folder("whole", *index))).count();
        let again = room.run(&room.all(), &out, &["--jobs", "2"]);
        lost += usize::from(!again.status.success() || tree(&room.path("whole")) != tree(&room.path(&out)));
        std::fs::remove_dir_all(room.path(&out)).expect("removed");
    }
    figure(36, "results that look finished after a kill and are not", torn, "0", kills);
    figure(36, "runs after a kill that did not end with the bytes of one run", lost, "0", kills);
    assert_eq!((torn, lost), (0, 0));
    assert!(met * 2 > kills, "only {met} of {kills} were killed before their end");
}

/// Negative control of the test above.
#[test]
fn a_torn_result_would_be_noticed() {
    let room = Room::new();
    room.recording("0.npy", 2, 1);
    assert!(room.run(&room.all(), "whole", &[]).status.success() && room.run(&room.all(), "cut", &[]).status.success());
    let (whole, cut) = (room.path("whole/0"), room.path("cut/0"));
    assert!(is_unfinished_or_whole(&cut, &whole));
    let array = cut.join("energyscape.npy");
    let bytes = std::fs::read(&array).expect("array");
    std::fs::write(&array, &bytes[..bytes.len() - 1]).expect("cut");
    assert!(!is_unfinished_or_whole(&cut, &whole));
    std::fs::remove_file(cut.join("meta.json")).expect("removed");
    assert!(is_unfinished_or_whole(&cut, &whole));
}

#[test]
fn shards_and_jobs_and_the_order_of_inputs_do_not_show_in_the_results() {
    let room = Room::new();
    let mut files: Vec<PathBuf> = (0..7).map(|index| room.recording(&format!("{index}.npy"), 3, index)).collect();
    assert!(room.run(&room.all(), "one", &["--jobs", "1"]).status.success());
    assert!(room.run(&room.all(), "five", &["--jobs", "5"]).status.success());
    assert_same(&room.path("one"), &room.path("five"));
    let mut seen = Vec::new();
    for shard in ["3/3", "1/3", "2/3"] {
        files.rotate_left(2);
        let output = room.run(&files, shard, &["--shard", shard]);
        assert!(output.status.success(), "{}", talk(&output));
        let mine: Vec<_> = std::fs::read_dir(room.path(shard)).expect("folder").flatten().collect();
        assert!((2..=3).contains(&mine.len()), "even parts");
        seen.extend(mine.iter().map(|entry| entry.file_name()));
        assert!(room.run(&files, "shards", &["--shard", shard]).status.success());
    }
    seen.sort();
    assert_eq!(
        seen,
        (0..7).map(|index| index.to_string().into()).collect::<Vec<std::ffi::OsString>>(),
        "disjoint, complete"
    );
    assert_same(&room.path("one"), &room.path("shards"));
    let none = room.run(&files, "none", &["--shard", "9/9"]);
    assert!(none.status.success(), "an empty part is no error: {}", talk(&none));
    for nonsense in ["0/3", "4/3", "1", "a/b", "1/0"] {
        let output = room.run(&files, "none", &["--shard", nonsense]);
        assert_eq!(output.status.code(), Some(2), "{nonsense}");
        assert!(talk(&output).contains("i from 1 to n"), "{}", talk(&output));
    }
}

#[test]
fn one_recording_on_all_cores_has_the_bytes_of_one_core() {
    let room = Room::new();
    let file = [room.recording("long.npy", 50, 3)];
    for jobs in ["1", "2", "7"] {
        let output = room.run(&file, jobs, &["--jobs", jobs]);
        assert!(output.status.success() && output.stdout.is_empty(), "{}", talk(&output));
        assert_same(&room.path("1"), &room.path(jobs));
    }
    assert_eq!(meta(&room.path("1"))["channels"].as_array().map(Vec::len), Some(50));
    assert_eq!(meta(&room.path("1"))["channels"][49]["stuck"], serde_json::json!([0, 1]));
}

#[test]
fn what_has_changed_is_done_again_and_nothing_else() {
    let room = Room::new();
    room.recording("a.npy", 2, 1);
    room.recording("b.npy", 2, 2);
    let redone = |more: &[&str]| -> Vec<String> {
        // A new time of writing is what shows that a file was made again.
        let stamp = |name: &str| {
            std::fs::metadata(room.path("out").join(name).join("meta.json")).and_then(|data| data.modified()).ok()
        };
        let before = ["a", "b"].map(stamp);
        std::thread::sleep(Duration::from_millis(20));
        let output = room.run(&room.all(), "out", more);
        assert!(output.status.success(), "{}", talk(&output));
        let changed = ["a", "b"].into_iter().zip(before).filter(|(name, before)| stamp(name) != *before);
        changed.map(|(name, _)| name.to_owned()).collect()
    };
    assert_eq!(redone(&[]), ["a", "b"]);
    assert!(redone(&[]).is_empty());
    room.recording("b.npy", 3, 2);
    assert_eq!(redone(&[]), ["b"], "another recording under the same name");
    assert_eq!(meta(&room.path("out/b"))["pings"], 3);
    std::fs::remove_file(room.path("out/a/energyscape.npy")).expect("removed");
    assert_eq!(redone(&[]), ["a"], "a result that is gone");
    let meta_a = std::fs::read(room.path("out/a/meta.json")).expect("meta");
    std::fs::write(room.path("out/a/meta.json"), &meta_a[..meta_a.len() / 2]).expect("cut");
    assert_eq!(redone(&[]), ["a"], "half a meta.json");
    assert_eq!(redone(&["--force"]), ["a", "b"]);
    assert_eq!(redone(&["--png"]), ["a", "b"], "pictures were not asked for before");
    room.config("range_min_m = 0.4");
    assert_eq!(redone(&["--png"]), ["a", "b"], "another configuration");
    std::fs::remove_file(room.path("out/b/energyscape_00002.png")).expect("removed");
    assert_eq!(redone(&["--png"]), ["b"], "a picture that is gone");
    room.config("range_min_m = 0.4\n[control]\nrate_hz = 5.0");
    assert!(redone(&["--png"]).is_empty(), "the controller has no part in images");
    room.recording("b.npy", 1, 2);
    assert_eq!(redone(&["--png"]), ["b"]);
    assert!(!room.path("out/b/energyscape_00001.png").exists(), "no picture of a ping that is no more");
}

#[test]
fn bad_recordings_among_good_ones_cost_nothing_but_themselves() {
    let room = Room::new();
    let good = [room.recording("a.npy", 3, 1), room.recording("z.npy", 3, 2)];
    assert!(room.run(&good, "good", &[]).status.success());
    std::fs::write(room.path("in/garbage.npy"), b"not a recording").expect("file");
    std::fs::write(room.path("in/notes.txt"), b"not taken for a recording").expect("file");
    let cut = room.recording("cut.npy", 5, 3);
    std::fs::OpenOptions::new().write(true).open(&cut).and_then(|file| file.set_len(128 + 1_000_000)).expect("cut");
    for round in 0..2 {
        let output = room.run(&room.all(), "out", &["--jobs", "3"]);
        let said = talk(&output);
        assert_eq!(output.status.code(), Some(65), "{said}");
        assert!(said.contains("garbage.npy: found no NumPy header") && said.contains("cut.npy"), "{said}");
        assert_eq!(said.matches("skipped").count(), 2 * round, "the bad ones are tried again: {said}");
    }
    assert_same(&room.path("good/a"), &room.path("out/a"));
    assert_same(&room.path("good/z"), &room.path("out/z"));
    let cut = meta(&room.path("out/cut"));
    assert_eq!((&cut["pings"], &cut["complete"]), (&3.into(), &false.into()), "its complete pings are kept");
    let array = npyz::NpyFile::new(std::fs::File::open(room.path("out/cut/energyscape.npy")).expect("file"));
    let array = array.expect("header");
    assert_eq!(array.shape()[0], 3);
    let cells = array.shape().iter().product::<u64>() as usize;
    assert_eq!(array.into_vec::<f32>().expect("values").len(), cells);
    assert!(!room.path("out/garbage/meta.json").exists());
    std::fs::create_dir(room.path("empty")).expect("folder");
    assert_eq!(room.run(&[room.path("empty")], "out", &[]).status.code(), Some(65));
    let missing = room.run(&[room.path("in/a.npy"), room.path("in/missing.npy")], "out", &[]);
    assert_eq!(missing.status.code(), Some(65), "{}", talk(&missing));
}

/// Largest resident set of a run, as the system counts it.
fn peak_kib(mut command: Command) -> u64 {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
    let status = PathBuf::from(format!("/proc/{}/status", child.id()));
    let mut peak = 0;
    while child.try_wait().expect("child").is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        peak = line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(peak);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(child.wait().expect("child").success());
    peak
}

#[cfg(target_os = "linux")]
#[test]
fn ten_times_the_recording_takes_no_more_memory() {
    let room = Room::new();
    let peak = |pings: usize| {
        let file = room.recording("long.npy", pings, 1);
        peak_kib(room.process(&[file], &format!("out{pings}"), &["--jobs", "2"]))
    };
    let (short, long) = (peak(40), peak(400));
    // A ping has 256 KiB, its image 137 KiB: kept in memory, 360 more would be 48 MiB and more. Measured: 0.1 MiB apart.
    assert!(short > 5_000, "{short} KiB: the peak was not seen");
    assert!(long < short + 2_048, "{short} KiB for 40 pings, {long} KiB for 400");
}
