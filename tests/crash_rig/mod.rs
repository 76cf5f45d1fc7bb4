//! Kills a process after any one of its calls that change files of a root and prefix, by a small library preloaded into it.
#![allow(dead_code, reason = "every test file uses another part")]

use crate::ipc_rig::Place;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The preloaded library, compiled from `shim.c`.
pub struct Shim {
    library: PathBuf,
    _directory: TempDir,
}

impl Shim {
    /// Compiles it. None, said aloud, where there is no C compiler: a Rust toolchain links with one, so that is rare.
    pub fn build() -> Option<Self> {
        let directory = TempDir::new().expect("directory");
        let library = directory.path().join("shim.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crash_rig/shim.c");
        let mut compiler = Command::new("cc");
        match compiler.args(["-shared", "-fPIC", "-O1", "-o"]).args([&library, &source]).arg("-ldl").status() {
            Ok(status) => assert!(status.success(), "shim.c does not compile: {status}"),
            Err(error) => {
                assert!(std::env::var("NOCTULE_REQUIRE_NAMESPACES").as_deref() != Ok("1"), "no C compiler: {error}");
                println!("!! LEFT OUT: no C compiler to make the crash points with: {error}");
                return None;
            }
        }
        Some(Self { library, _directory: directory })
    }

    /// Lists the calls of `command` in `log`.
    pub fn listing<'a>(&self, command: &'a mut Command, place: &Place, log: &Path) -> &'a mut Command {
        self.preload(command, place).env("CRASH_LOG", log)
    }

    /// Kills what `command` starts after call number `at`, the first being 1.
    pub fn killing<'a>(&self, command: &'a mut Command, place: &Place, at: usize) -> &'a mut Command {
        self.preload(command, place).env("CRASH_AT", at.to_string())
    }

    fn preload<'a>(&self, command: &'a mut Command, place: &Place) -> &'a mut Command {
        command
            .env("LD_PRELOAD", &self.library)
            .env("CRASH_ROOT", place.root())
            .env("CRASH_PREFIX", &place.params.prefix)
    }
}

/// This very program, for one of its tests that are processes and none of their own, at `place`.
pub fn this_program(place: &Place, test: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command
        .args(["--exact", test, "--test-threads", "1", "--quiet", "--nocapture"])
        .env("NOCTULE_TEST_ROOT", place.root())
        .env("NOCTULE_TEST_PREFIX", &place.params.prefix)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

/// Kills its process when dropped.
pub struct Killed(pub Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Waits for the end of a process; kills it after `limit` and gives `None`.
pub fn wait_at_most(child: &mut Killed, limit: Duration) -> Option<ExitStatus> {
    let deadline = Instant::now() + limit;
    while Instant::now() < deadline {
        if let Some(status) = child.0.try_wait().expect("waited") {
            return Some(status);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let _ = child.0.kill();
    let _ = child.0.wait();
    None
}

pub fn was_killed(status: ExitStatus) -> bool {
    status.signal() == Some(9)
}

/// Waits for a file to appear; false after `limit`.
pub fn appears(path: &Path, limit: Duration) -> bool {
    let deadline = Instant::now() + limit;
    while Instant::now() < deadline {
        if path.exists() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    false
}

/// The numbers 1 to `count`, or every n-th of them from an offset that `seed` gives, so that there are at most `wanted`.
pub fn sampled(count: usize, wanted: usize, seed: u64) -> Vec<usize> {
    let step = count.div_ceil(wanted.max(1)).max(1);
    let offset = usize::try_from(seed % step as u64).expect("small");
    (1 + offset..=count).step_by(step).collect()
}
