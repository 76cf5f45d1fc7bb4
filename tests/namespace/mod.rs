//! Runs a test in a mount namespace of its own: a /dev/shm of a chosen size and a directory for temporary files that no other
//! process sees, so that processes can be killed and files deleted for real.
//!
//! Needs util-linux and either root or user namespaces. Where neither is to be had the test says so and is left out, unless
//! `NOCTULE_REQUIRE_NAMESPACES=1`, which makes it fail.
#![allow(dead_code, reason = "every test file uses another part")]

use std::process::{Command, Stdio};

/// Set in the processes inside.
const INSIDE: &str = "NOCTULE_TEST_NAMESPACE";

/// What the process inside is run by: `unshare` as root, or with a user namespace of which it is root.
fn unshare() -> Option<&'static [&'static str]> {
    let ways: [&[&str]; 2] = [&["--mount"], &["--user", "--map-root-user", "--mount"]];
    ways.into_iter().find(|way| {
        let tried = Command::new("unshare")
            .args(*way)
            .args(["sh", "-c", "mount -t tmpfs tmpfs /dev/shm"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        tried.is_ok_and(|status| status.success())
    })
}

/// Whether this process runs inside.
pub fn is_inside() -> bool {
    std::env::var_os(INSIDE).is_some()
}

/// Runs `body` of the test named `test` in a namespace of its own, whose /dev/shm has `shared_memory` bytes (`1m`, `256m`). The
/// test program is started again for this one test; what it prints is printed.
pub fn isolated(test: &str, shared_memory: &str, body: impl FnOnce()) {
    if is_inside() {
        return body();
    }
    let Some(way) = unshare() else {
        assert!(
            std::env::var("NOCTULE_REQUIRE_NAMESPACES").as_deref() != Ok("1"),
            "mount namespaces are required, and this system allows none"
        );
        println!("!! LEFT OUT: {test}: this system allows no mount namespace");
        return;
    };
    let directory = tempfile::tempdir().expect("directory");
    let script =
        r#"mount -t tmpfs -o "size=$0" tmpfs /dev/shm && mount -t tmpfs -o size=64m tmpfs "$TMPDIR" && exec "$@""#;
    let status = Command::new("unshare")
        .args(way)
        .args(["sh", "-c", script, shared_memory])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--nocapture", "--quiet", "--test-threads", "1"])
        .env(INSIDE, test)
        .env("TMPDIR", directory.path())
        .status()
        .expect("started");
    assert!(status.success(), "{test}, in its namespace: {status}");
}
