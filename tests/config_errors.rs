//! Contract: every file in fixtures/config/broken is refused with the sentence stored beside it, which names file, line,
//! key, what was found and what is allowed; and no bytes whatever make the reader panic, wait or grow.
//!
//! The comments at the top of each broken file say by hand what its error has to name. The full texts, and the example of a
//! good file, are made by `NOCTULE_BLESS=1 cargo test --test config_errors` and then read by a person.

use noctule::config::Config;
use noctule::document::{DocumentError, DocumentErrorKind};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

const BROKEN: &str = "fixtures/config/broken";

fn broken_files() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(BROKEN).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    files.sort();
    files
}

/// What the head of a broken file says of `field`.
fn stated<'t>(text: &'t str, field: &str) -> &'t str {
    let line = text.lines().find_map(|line| line.strip_prefix(&format!("# {field}:")));
    line.unwrap_or_else(|| panic!("no `# {field}:` in\n{text}")).trim()
}

/// What is wrong with an error, judged by the head of its file.
fn complaints(text: &str, error: &DocumentError) -> Vec<String> {
    let mut complaints = Vec::new();
    let line: usize = stated(text, "line").parse().unwrap();
    if error.line != Some(line) || !error.rendered.contains(&format!(".toml:{line}:")) {
        complaints.push(format!("line {line} is not named"));
    }
    let key = stated(text, "key");
    if error.key.as_deref().unwrap_or_default() != key || !error.summary.starts_with(key) {
        complaints.push(format!("key {key} is not named"));
    }
    let Some((found, allowed)) = error.summary.split_once(", allowed: ") else {
        return vec!["not of the form `found ..., allowed: ...`".to_owned()];
    };
    if !found.contains("found ") || !found.contains(stated(text, "found")) {
        complaints.push(format!("found {} is not said", stated(text, "found")));
    }
    if !allowed.contains(stated(text, "allowed")) {
        complaints.push(format!("allowed {} is not said", stated(text, "allowed")));
    }
    complaints
}

#[test]
fn every_broken_file_is_refused_with_its_own_sentence() {
    let files = broken_files();
    assert!(files.len() >= 50, "{} files", files.len());
    let mut wrong = Vec::new();
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let Err(error) = Config::load(&path) else {
            wrong.push(format!("{} was accepted", path.display()));
            continue;
        };
        assert_eq!(error.kind, DocumentErrorKind::Content);
        wrong.extend(complaints(&text, &error).into_iter().map(|complaint| format!("{complaint} in\n{error}\n")));
        let expected_path = path.with_extension("expected");
        if std::env::var_os("NOCTULE_BLESS").is_some() {
            std::fs::write(&expected_path, format!("{error}\n")).unwrap();
        }
        let expected = std::fs::read_to_string(&expected_path).unwrap_or_default();
        if expected.trim_end() != error.to_string() {
            wrong.push(format!("{} is\n{error}\nand not\n{expected}", path.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_sentence_that_names_the_wrong_line_key_or_value_would_be_noticed() {
    let path = Path::new(BROKEN).join("range_step_zero.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let error = Config::load(&path).unwrap_err();
    assert_eq!(complaints(&text, &error), Vec::<String>::new());
    for (right, wrong) in [
        ("# line: ", "# line: 1"),
        ("# key: ", "# key: x"),
        ("# found: ", "# found: y"),
        ("# allowed: ", "# allowed: z"),
    ] {
        assert_eq!(complaints(&text.replace(right, wrong), &error).len(), 1, "{wrong}");
    }
}

#[test]
fn a_missing_file_a_folder_and_a_locked_file_are_told_apart_from_a_bad_one() {
    let folder = tempfile::tempdir().unwrap();
    let missing = Config::load(&folder.path().join("robot.toml")).unwrap_err();
    assert!(
        missing.kind == DocumentErrorKind::Missing && missing.to_string().contains("robot.toml: found no such file")
    );
    let directory = Config::load(folder.path()).unwrap_err();
    assert!(directory.kind == DocumentErrorKind::Unreadable && directory.to_string().contains("found a directory"));
    assert_eq!((missing.to_string().lines().count(), directory.to_string().lines().count()), (1, 1));
}

#[test]
fn an_endless_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.toml");
    std::fs::File::create(&path).unwrap().set_len(100_000_000).unwrap();
    let error = Config::load(&path).unwrap_err();
    assert!(error.summary.contains("found 100000000 bytes, allowed: at most"), "{error}");
}

#[test]
fn the_complete_example_is_the_built_in_robot_as_the_program_prints_it() {
    let path = Path::new("fixtures/config/robot.toml");
    if std::env::var_os("NOCTULE_BLESS").is_some() {
        std::fs::write(path, Config::default().to_toml()).unwrap();
    }
    assert_eq!(std::fs::read_to_string(path).unwrap(), Config::default().to_toml());
    let example = Config::load(path).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(example, Config { base_dir: example.base_dir.clone(), ..Config::default() });
    assert_eq!(example.warnings(), Vec::<String>::new());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn a_broken_byte_anywhere_in_the_example_never_panics(
        place in any::<prop::sample::Index>(), byte in any::<u8>(), length in 0usize..40,
    ) {
        let mut bytes = std::fs::read("fixtures/config/robot.toml").unwrap();
        let start = place.index(bytes.len());
        let end = (start + length).min(bytes.len());
        bytes.splice(start..end, [byte]);
        // Either answer is right; what counts is that there is one.
        if let Err(error) = Config::parse(&String::from_utf8_lossy(&bytes), Path::new("fixtures/config/robot.toml")) {
            prop_assert!(!error.rendered.is_empty() && error.rendered.contains("robot.toml"));
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = Config::parse(&String::from_utf8_lossy(&bytes), Path::new("robot.toml"));
    }
}
