//! Instructions that each stage of the CPU backend takes for a ping, counted by valgrind's callgrind and held to a committed table:
//! the counts repeat on a machine where times do not, so that a stage that has become slower is seen.
//!
//! `cargo bench --bench instructions`; `NOCTULE_BLESS=1` writes the table anew (not with `CARGO_INCREMENTAL=1`, which makes other
//! code). One sensor, one thread. Valgrind knows no AVX-512: what is counted is the AVX2 path on any processor that has it.
//! A stage's count is that of a ping up to and with it, and of handing its result out to be looked at; `image` is everything and
//! hands out nothing. Without valgrind it says so and passes, unless `NOCTULE_REQUIRE_VALGRIND=1`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::scenes::{Case, random_masks};
use noctule::imaging::backend::{Backend, Image, Stage};
use noctule::imaging::cpu::CpuBackend;
use noctule::imaging::plan::ImagingPlan;
use noctule::signal::{PingSet, SampleFormat, Samples};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::{Command, ExitCode};
use std::sync::Arc;

/// Largest change of a count with the compiler that the table was made with. Measured: runs of one build agree to the last instruction;
/// 2 % leaves room for how the compiler divides the crate when code elsewhere changes.
const TOLERANCE: f64 = 0.02;
/// With another compiler, whose counts are its own.
const TOLERANCE_OTHER_COMPILER: f64 = 0.15;
const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/instructions.txt");
const FORMATS: [(SampleFormat, &str); 2] = [(SampleFormat::PcmF32, "pcm-f32"), (SampleFormat::Pdm, "pdm")];
/// Beyond the stages: the judging of channels, and everything together.
const CHANNELS: &str = "channels";
const IMAGE: &str = "image";
/// Pings that are counted together.
const PINGS: u64 = 2;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, format] = arguments.as_slice()
        && flag == "--count"
    {
        count(format);
        return ExitCode::SUCCESS;
    }
    if Command::new("valgrind").arg("--version").output().is_err() {
        println!("valgrind is not installed: nothing is counted");
        return ExitCode::from(u8::from(std::env::var_os("NOCTULE_REQUIRE_VALGRIND").is_some()));
    }
    let (found, set) = measure_all();
    let compiler = compiler();
    if std::env::var_os("NOCTULE_BLESS").is_some() {
        let table = table(&compiler, &set, &found);
        std::fs::write(TABLE, &table).expect("written");
        print!("{table}");
        return ExitCode::SUCCESS;
    }
    compare(&compiler, &set, &found)
}

/// What is counted, in this order.
fn wholes() -> impl Iterator<Item = &'static str> {
    Stage::ALL.into_iter().map(Stage::stem).chain([CHANNELS, IMAGE])
}

/// What runs under valgrind: everything is made ready, then [`counted`] is called once for each of [`wholes`].
fn count(format: &str) {
    let format = FORMATS.iter().find(|(_, name)| *name == format).expect("a known format").0;
    let case = Case::standard("instructions", format, 1, 1);
    let plan = case.plan();
    let masks = random_masks(&plan, 7);
    let pings = noise(&plan);
    let mut image = Image::empty(&plan, &masks);
    let mut backend = CpuBackend::open(Arc::clone(&plan), masks, Some(1)).expect("opens");
    backend.image(&pings, &mut image).expect("imaged");
    println!("{}", backend.report().adapter);
    for what in wholes() {
        let stage = Stage::ALL.into_iter().find(|stage| stage.stem() == what);
        counted(|| match (what, stage) {
            (_, Some(stage)) => drop(backend.image_up_to(stage, &pings, 0, &mut image).expect("imaged")),
            (CHANNELS, None) => image.channels[0].judge(&plan, 0, &pings.pings[0].samples),
            _ => backend.image(&pings, &mut image).expect("imaged"),
        });
    }
}

/// Random words, or white noise of a tenth of full scale: under valgrind, echoes would take longer to make than to image.
fn noise(plan: &ImagingPlan) -> PingSet {
    let mut pings = PingSet::empty(1, plan.format, &[plan.raw_len(0)]);
    pings.present[0] = true;
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 32) as u32
    };
    match pings.pings[0].samples_mut() {
        Samples::Pdm(words) => words.fill_with(&mut next),
        Samples::PcmI16(values) => values.fill_with(|| (next() as i16) / 10),
        Samples::PcmF32(values) => values.fill_with(|| (next() as i32) as f32 * (0.1 / 2_147_483_648.0)),
    }
    pings
}

/// Valgrind counts what happens in here, by the function's name.
#[inline(never)]
fn counted(mut work: impl FnMut()) {
    for _ in 0..PINGS {
        work();
    }
    // Something after the loop: as a tail call the work would leave this function.
    std::hint::black_box(&mut work);
}

/// Instructions per ping by `format/stage`, and the instruction set that was counted.
fn measure_all() -> (BTreeMap<String, u64>, String) {
    let mut found = BTreeMap::new();
    let mut set = String::new();
    for (_, format) in FORMATS {
        let (counts, adapter) = measure(format);
        set = adapter;
        for (what, count) in wholes().zip(counts) {
            found.insert(format!("{format}/{what}"), count);
        }
    }
    (found, set)
}

/// Counts of one format in the order of [`wholes`]: valgrind writes a file each time that [`counted`] ends.
fn measure(format: &str) -> (Vec<u64>, String) {
    let this = std::env::current_exe().expect("this program");
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("counts");
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--collect-atstart=no"])
        .args(["--toggle-collect=instructions::counted", "--dump-after=instructions::counted"])
        .arg(format!("--callgrind-out-file={}", file.display()))
        .arg(this)
        .args(["--count", format])
        .output()
        .expect("valgrind runs");
    assert!(output.status.success(), "{format}: {}", String::from_utf8_lossy(&output.stderr));
    let count = |index: usize| {
        let text = std::fs::read_to_string(file.with_extension((index + 1).to_string())).expect("a file of counts");
        let total = text.lines().find_map(|line| line.strip_prefix("totals: ")).expect("a total");
        let total: u64 = total.trim().parse().expect("a number");
        assert!(total > 0, "{format}: nothing was counted");
        total / PINGS
    };
    let counts = (0..wholes().count()).map(count).collect();
    (counts, String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn compiler() -> String {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("--version").output();
    output.map_or("unknown".to_owned(), |output| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn table(compiler: &str, set: &str, found: &BTreeMap<String, u64>) -> String {
    let mut text = format!(
        "# Instructions per ping of one sensor on one thread, by benches/instructions.rs\n# {compiler}\n# {set}\n"
    );
    for (name, count) in found {
        writeln!(text, "{name:24} {count:>12}").expect("text");
    }
    text
}

fn compare(compiler: &str, set_here: &str, found: &BTreeMap<String, u64>) -> ExitCode {
    let text = std::fs::read_to_string(TABLE).expect("the committed table; NOCTULE_BLESS=1 makes it");
    let mut header = text.lines().filter_map(|line| line.strip_prefix("# ")).skip(1);
    let (made_with, set) = (header.next().unwrap_or(""), header.next().unwrap_or(""));
    if set != set_here {
        println!("the table is of {set}, this machine runs {set_here} under valgrind: nothing to compare");
        return ExitCode::SUCCESS;
    }
    let tolerance = if made_with == compiler { TOLERANCE } else { TOLERANCE_OTHER_COMPILER };
    println!("table made with {made_with}, here {compiler}: within {:.0} %", tolerance * 100.0);
    let mut red = false;
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let (name, count) = line.split_once(char::is_whitespace).expect("a name and a number");
        let expected: u64 = count.trim().parse().expect("a number");
        let counted = found.get(name).copied().unwrap_or(0);
        let change = counted as f64 / expected.max(1) as f64 - 1.0;
        let verdict = if change.abs() <= tolerance || counted == expected { "" } else { "  <-- changed" };
        red |= !verdict.is_empty();
        println!("{name:24} {expected:>12} {counted:>12} {:>+8.2} %{verdict}", change * 100.0);
    }
    if red {
        println!("slower: find out why. Faster, or meant: NOCTULE_BLESS=1 cargo bench --bench instructions");
    }
    ExitCode::from(u8::from(red))
}
