//! Contract: the examples in Rust and C show what was published, to the digit; the C header in the tree is the one that the program prints,
//! and a C compiler takes it. The Python client has a test file of its own.

mod client_rig;
mod ipc_rig;

use client_rig::{Publisher, compare, run, stdout};
use noctule::io::c_header::c_header;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

const C_EXAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/c");

/// Where the examples lie, built as they are now: a run of this file alone does not build them.
fn examples() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let programs = Path::new(env!("CARGO_BIN_EXE_noctule")).parent().expect("a folder");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "--quiet", "--example", "energyscape_peak", "--example", "noctule_c"]);
        cargo.current_dir(env!("CARGO_MANIFEST_DIR"));
        if programs.ends_with("release") {
            cargo.arg("--release");
        }
        let built = cargo.output().expect("cargo");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        programs.join("examples")
    })
}

fn cc(arguments: &[&str]) -> Output {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let mut command = Command::new(compiler);
    command.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-I", C_EXAMPLES]).args(arguments);
    command.output().expect("a C compiler, as Rust's own linking needs one")
}

/// The C example, linked with the library.
fn c_example(folder: &Path) -> PathBuf {
    let program = folder.join("energyscape_peak");
    let library = examples().to_str().expect("UTF-8");
    let source = format!("{C_EXAMPLES}/energyscape_peak.c");
    let run_path = format!("-Wl,-rpath,{library}");
    let path = program.to_str().expect("UTF-8");
    let built = cc(&[&source, "-L", library, "-lnoctule_c", &run_path, "-lm", "-o", path]);
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    program
}

/// What eight lines of a client say, held against what was published; and against pings that were not.
fn judge(publisher: &mut Publisher, client: &mut Command) {
    let output = run(client, || publisher.publish_next());
    assert_eq!(compare(stdout(&output), &publisher.published), Ok(8));
    // Negative control: one range bin beside the published one.
    let mut beside = publisher.published.clone();
    beside.values_mut().for_each(|published| published.range_m += 0.0125);
    assert!(compare(stdout(&output), &beside).is_err());
}

#[test]
fn the_rust_example_prints_what_was_published() {
    let mut publisher = Publisher::new();
    let config = publisher.place.config_file();
    let mut client = Command::new(examples().join("energyscape_peak"));
    client.arg("--config").arg(config).args(["--sensor", "left", "--count", "8", "--timeout", "20"]);
    judge(&mut publisher, &mut client);
}

#[test]
fn the_c_example_prints_what_was_published() {
    let mut publisher = Publisher::new();
    let config = publisher.place.config_file();
    let program = c_example(publisher.place.directory.path());
    let mut client = Command::new(&program);
    client.arg(&config).args(["left", "8", "20000"]);
    judge(&mut publisher, &mut client);

    let stranger = Command::new(&program).arg(&config).args(["rear", "1", "100"]).output().expect("run");
    assert_eq!(stranger.status.code(), Some(69));
    let said = String::from_utf8_lossy(&stranger.stderr);
    assert!(said.contains("sensors are: front, left, right"), "{said}");
    let silent = Command::new(&program).arg(&config).args(["left", "1", "100"]).output().expect("run");
    assert_eq!(String::from_utf8_lossy(&silent.stderr), "no ping in time\n");
}

#[test]
fn the_c_header_in_the_tree_is_the_one_that_the_program_prints_and_c_takes_it() {
    let path = format!("{C_EXAMPLES}/noctule_types.h");
    if std::env::var_os("NOCTULE_BLESS").is_some_and(|value| value == "1") {
        std::fs::write(&path, c_header()).expect("written");
    }
    let stored = std::fs::read_to_string(&path).expect("the header");
    assert_eq!(stored, c_header(), "NOCTULE_BLESS=1 cargo test --test clients writes it anew");
    let printed = Command::new(env!("CARGO_BIN_EXE_noctule")).args(["topics", "--c-header"]).output().expect("run");
    assert_eq!(stdout(&printed), stored);

    let directory = tempfile::tempdir().expect("directory");
    let file = directory.path().join("header.c");
    let compiles = |header: &str| {
        std::fs::write(&file, header).expect("written");
        cc(&["-fsyntax-only", file.to_str().expect("UTF-8")]).status.success()
    };
    assert!(compiles(&stored));
    // Negative control: one field fewer, and every offset behind it is wrong.
    let field = "    uint64_t epoch; ";
    let line = stored.lines().find(|line| line.starts_with(field)).expect("a field");
    assert!(!compiles(&stored.replacen(line, "", 1)), "a missing field went unnoticed");
}
