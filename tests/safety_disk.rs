//! Contract (check 37, as far as there is something to write): a disk that is full or read-only ends `process` and `simulate` with
//! one line that names the file, and 74 or 73; what was finished before stays whole, and no file is there by halves.

mod checks;
mod namespace;

use namespace::{is_inside, isolated};
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const CHANNELS: usize = 32;
const SAMPLES: usize = 4096;
const IO: i32 = 74;
const CANNOT_CREATE: i32 = 73;

/// A disk of its own of a few kilobytes, beside a folder with input.
struct Room {
    folder: PathBuf,
    disk: PathBuf,
}

impl Room {
    fn new(disk_kib: usize) -> Self {
        assert!(is_inside(), "only a namespace of its own may mount");
        let folder = std::env::temp_dir().join(format!("room{disk_kib}"));
        let disk = folder.join("disk");
        fs::create_dir_all(&disk).expect("made");
        let room = Self { folder, disk };
        room.mount(&["-t", "tmpfs", "-o", &format!("size={disk_kib}k"), "tmpfs"]);
        let text = format!(
            "config_version = 1\n[recording]\nformat = \"pcm-i16\"\nsamples = {SAMPLES}\n[imaging]\nrange_max_m = 1.1\n"
        );
        fs::write(room.folder.join("robot.toml"), text).expect("written");
        room
    }

    fn mount(&self, arguments: &[&str]) {
        let status = Command::new("mount").args(arguments).arg(&self.disk).status().expect("mount");
        assert!(status.success(), "{arguments:?}");
    }

    fn read_only(&self) {
        self.mount(&["-o", "remount,ro"]);
    }

    fn recording(&self, name: &str, pings: usize) -> PathBuf {
        let path = self.folder.join(name);
        let mut file = fs::File::create(&path).expect("made");
        let dict = format!("{{'descr': '<i2', 'fortran_order': False, 'shape': ({pings}, {CHANNELS}, {SAMPLES}), }}");
        file.write_all(b"\x93NUMPY\x01\x00\x76\x00").expect("written");
        file.write_all(format!("{dict:117}\n").as_bytes()).expect("written");
        let noise = (0..pings * CHANNELS * SAMPLES).map(|index| (index as u32).wrapping_mul(2_654_435_761) >> 20);
        let bytes: Vec<u8> = noise.flat_map(|value| (value as i16).to_le_bytes()).collect();
        file.write_all(&bytes).expect("written");
        path
    }

    fn process(&self, input: &Path, out: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
        command.arg("process").arg(input).arg("--config").arg(self.folder.join("robot.toml"));
        command.args(["--backend", "cpu", "--quiet", "--out"]).arg(self.disk.join(out));
        command.output().expect("runs")
    }

    fn simulate(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
        let text =
            fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/worlds/wall.toml")).expect("there");
        let short = text.replace("time_limit_s = 40.0", "time_limit_s = 1.0");
        assert_ne!(text, short, "the world has another time limit");
        let world = self.folder.join("short.toml");
        fs::write(&world, short).expect("written");
        command.arg("simulate").arg(world).args(["--backend", "cpu", "--jobs", "1"]).args(arguments);
        command.current_dir(&self.disk).output().expect("runs")
    }

    /// Everything on the disk, by its path and size.
    fn content(&self) -> Vec<(String, u64)> {
        let mut found = Vec::new();
        let mut folders = vec![self.disk.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("readable").flatten() {
                let metadata = entry.metadata().expect("there");
                if metadata.is_dir() {
                    folders.push(entry.path());
                } else {
                    found.push((entry.path().display().to_string(), metadata.len()));
                }
            }
        }
        found.sort();
        found
    }
}

/// The run must have ended with `code` and one line that names something on the disk.
fn assert_told(output: &Output, code: i32, what: &str) {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let complaints: Vec<&str> = text.lines().filter(|line| line.contains("/disk/") || line.contains("error")).collect();
    assert_eq!(output.status.code(), Some(code), "{what}: {text}");
    assert!(!complaints.is_empty() && complaints.iter().any(|line| line.contains("disk")), "{what}: {text}");
    assert!(!text.contains("panicked"), "{what}: {text}");
}

#[test]
fn a_full_disk_ends_process_with_74_and_what_was_finished_stays() {
    isolated("a_full_disk_ends_process_with_74_and_what_was_finished_stays", "64m", || {
        // One short recording fits, a longer one does not.
        let room = Room::new(1_024);
        let (first, second) = (room.recording("first.npy", 1), room.recording("second.npy", 40));
        assert!(room.process(&first, "first").status.success());
        let before = room.content();
        assert!(before.len() >= 4, "{before:?}");
        let full = room.process(&second, "second");
        assert_told(&full, IO, "process on a full disk");
        let after = room.content();
        for file in &before {
            assert!(after.contains(file), "{file:?} was changed; now {after:?}");
        }
        assert!(!after.iter().any(|(path, _)| path.ends_with(".partial")), "{after:?}");
        assert!(!after.iter().any(|(path, _)| path.ends_with("second/energyscape.npy")), "{after:?}");
        checks::figure(37, "process on a full disk", "74, first result whole", "74, nothing else lost", 1);

        room.read_only();
        let third = room.recording("third.npy", 1);
        let refused = room.process(&third, "third");
        assert_told(&refused, CANNOT_CREATE, "process on a read-only disk");
        assert_eq!(room.content(), after);
        checks::figure(37, "process on a read-only disk", "73, nothing changed", "73, nothing else lost", 1);
    });
}

#[test]
fn a_full_or_read_only_disk_ends_simulate_with_74_or_73_and_no_file_by_halves() {
    isolated("a_full_or_read_only_disk_ends_simulate_with_74_or_73_and_no_file_by_halves", "64m", || {
        let room = Room::new(64);
        assert!(room.simulate(&["--json", "good.json"]).status.success());
        let good = room.content();
        let mut filler = fs::File::create(room.disk.join("filler")).expect("made");
        while filler.write_all(&[0; 4096]).is_ok() {}
        drop(filler);
        let mut trials = 0;
        for arguments in
            [["--json", "bad.json"], ["--trajectories", "ways"], ["--plot", "map.png"], ["--paths", "ways.png"]]
        {
            let output = room.simulate(&arguments);
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(IO), "{arguments:?}: {text}");
            assert!(text.contains(arguments[1]), "{arguments:?}: {text}");
            let now = room.content();
            assert!(good.iter().all(|file| now.contains(file)), "{now:?}");
            assert!(!now.iter().any(|(path, _)| path.ends_with(".partial")), "{now:?}");
            assert!(!now.iter().any(|(path, len)| path.contains(arguments[1]) && *len == 0), "{now:?}");
            trials += 1;
        }
        checks::figure(37, "simulate on a full disk", "all 74", "74, nothing else lost", trials);
        room.read_only();
        for arguments in [["--json", "bad.json"], ["--plot", "map.png"]] {
            let output = room.simulate(&arguments);
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(CANNOT_CREATE), "{arguments:?}: {text}");
            assert!(text.contains(arguments[1]), "{arguments:?}: {text}");
        }
        checks::figure(37, "simulate on a read-only disk", "all 73", "73, nothing else lost", 2);
    });
}

/// Negative control: what these tests look for, they see: a result by halves, one that was changed, a disk that has room.
#[test]
fn a_result_by_halves_would_be_noticed() {
    isolated("a_result_by_halves_would_be_noticed", "64m", || {
        let room = Room::new(8 << 10);
        let first = room.recording("first.npy", 1);
        let roomy = room.process(&first, "first");
        assert!(roomy.status.success(), "a disk with room ends nothing");
        assert!(std::panic::catch_unwind(|| assert_told(&roomy, IO, "planted")).is_err(), "success taken for an end");
        let before = room.content();
        let result = room.disk.join("first/energyscape.npy");
        let whole = fs::metadata(&result).expect("there").len();
        fs::File::options().write(true).open(&result).expect("opened").set_len(whole / 2).expect("cut");
        fs::write(room.disk.join("first/meta.json.partial"), "{").expect("written");
        let after = room.content();
        assert!(before.iter().any(|file| !after.contains(file)), "a cut result is taken for whole");
        assert!(after.iter().any(|(path, _)| path.ends_with(".partial")), "a file by halves is not seen");
    });
}
