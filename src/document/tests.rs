//! Contract: whatever is wrong with a document, its error names file, line, key, what was found and what is allowed.
//! And no bytes at all make the reader panic.

use super::*;
use crate::geometry::shape::Shape;
use crate::parameter::check_positive;
use proptest::prelude::*;
use serde::Deserialize;

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Robot {
    name: String,
    #[serde(default)]
    legs: u8,
    #[serde(default)]
    gait: Option<Gait>,
    #[serde(default)]
    arm: Vec<Arm>,
    #[serde(default)]
    zone: Option<Shape>,
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Gait {
    Walk,
    SlowTrot,
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arm {
    length_m: f64,
    #[serde(default)]
    mount: Mount,
}

#[derive(Debug, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Mount {
    height_m: f64,
    at_m: [f64; 2],
}

fn validate(robot: &Robot) -> Result<(), ParameterError> {
    for (index, arm) in robot.arm.iter().enumerate() {
        check_positive(&format!("arm[{index}].length_m"), arm.length_m, 2.0)?;
        check_positive(&format!("arm[{index}].mount.height_m"), arm.mount.height_m + 1.0, 2.0)?;
    }
    robot.zone.as_ref().map_or(Ok(()), |zone| zone.validate("zone"))
}

fn error(text: &str) -> DocumentError {
    parse(Path::new("robot.toml"), text, validate).expect_err(text)
}

#[track_caller]
fn expect(text: &str, line: usize, key: &str, parts: &[&str]) {
    let error = error(text);
    assert_eq!((error.line, error.key.as_deref()), (Some(line), Some(key)), "{error}");
    assert!(error.rendered.contains("robot.toml:") && error.rendered.contains(&format!("{line} | ")), "{error}");
    for part in parts {
        assert!(error.rendered.contains(part), "no {part:?} in\n{error}");
    }
}

#[test]
fn an_unknown_key_is_named_with_the_allowed_ones_and_the_nearest() {
    let parts = ["legz: found an unknown key", "`name`, `legs`, `gait`", "the nearest is `legs`", "legz = 4\n  | ^^^^"];
    expect("name = \"a\"\nlegz = 4", 2, "legz", &parts);
    let parts = ["in arm[0].mount, allowed: `height_m`, `at_m`", "the nearest is `height_m`"];
    expect("name = \"a\"\n[[arm]]\nlength_m = 1\nmount = { heigth_m = 1 }", 4, "arm[0].mount.heigth_m", &parts);
    expect("name = \"a\"\n[[arm]]\nlength_m = 1\n[arm.mnt]\nx = 1", 4, "arm[0].mnt", &["unknown key in arm[0]"]);
}

#[test]
fn a_key_unlike_any_other_gets_no_advice() {
    assert!(!error("name = \"a\"\nqqq = 4").rendered.contains("nearest"));
}

#[test]
fn a_wrong_type_is_told_in_words_with_the_text_of_the_file() {
    expect("name = 7", 1, "name", &["found 7, allowed: a string", "name = 7\n  |        ^"]);
    expect("name = \"a\"\nlegs = \"four\"", 2, "legs", &["found \"four\", allowed: a whole number"]);
    expect("name = \"a\"\nlegs = -1", 2, "legs", &["found -1, allowed: a whole number, 0 or more"]);
    expect("name = \"a\"\narm = 3", 2, "arm", &["found 3, allowed: a list"]);
    expect("name = \"a\"\n[arm]\nlength_m = 1", 2, "arm", &["found a table, allowed: a list", "written [[arm]]"]);
    expect("name = \"a\"\n[[arm]]\nlength_m = true", 3, "arm[0].length_m", &["found true, allowed: a number"]);
    expect("name = \"a\"\n[[arm]]\nlength_m = 1\nmount = 7", 4, "arm[0].mount", &["found 7, allowed: a table"]);
    let at = "name = \"a\"\n[[arm]]\nlength_m = 1\nmount.at_m = ";
    expect(&format!("{at}[1]"), 4, "arm[0].mount.at_m", &["found [1], allowed: a list of 2 values"]);
    expect(&format!("{at}[1, 'x']"), 4, "arm[0].mount.at_m[1]", &["found 'x', allowed: a number"]);
}

#[test]
fn a_misspelt_choice_is_told_the_choices() {
    let parts = ["found \"slow-trott\", allowed: \"walk\", \"slow-trot\"", "the nearest is `slow-trot`"];
    expect("name = \"a\"\ngait = \"slow-trott\"", 2, "gait", &parts);
    expect("name = \"a\"\ngait = 3", 2, "gait", &["found 3, allowed: a string"]);
}

#[test]
fn a_missing_key_is_placed_at_its_table() {
    expect("name = \"a\"\n\n[[arm]]\nmount = {}", 3, "arm[0].length_m", &["found nothing"]);
    let root = error("legs = 4");
    assert_eq!(root.key.as_deref(), Some("name"));
    assert!(root.rendered.contains("robot.toml") && root.rendered.contains("name: found nothing"), "{root}");
}

#[test]
fn a_refused_value_is_found_by_its_dotted_key_and_else_by_its_table() {
    let text = "name = \"a\"\n[[arm]]\nlength_m = 1\n[[arm]]\nlength_m = nan # too long\n";
    expect(text, 5, "arm[1].length_m", &["found NaN, allowed: a number above 0, at most 2", "length_m = nan"]);
    let text = "name = \"a\"\n[[arm]]\nlength_m = 1\nmount = { height_m = -3.0 }\n";
    expect(text, 4, "arm[0].mount.height_m", &["found -2"]);
    let judge = |_: &Robot| Err(ParameterError::new("arm[0].mount.at_m", "nothing", "something"));
    let error = parse::<Robot>(Path::new("robot.toml"), "name = \"a\"\n[[arm]]\nlength_m = 1\n", judge).unwrap_err();
    assert_eq!((error.line, error.key.as_deref()), (Some(2), Some("arm[0].mount.at_m")), "{error}");
}

#[test]
fn keys_inside_a_shape_keep_their_line() {
    let zone = "name = \"a\"\n[zone]\nshape = \"circle\"\ncentre_m = [0, 0]\n";
    expect(&format!("{zone}radius = 1"), 5, "zone.radius", &["unknown key in zone", "the nearest is `radius_m`"]);
    expect(&format!("{zone}x_m = [0, 1]\nradius_m = 1"), 5, "zone.x_m", &["allowed: `shape`, `centre_m`, `radius_m`"]);
    expect(&format!("{zone}radius_m = [0, 1]"), 5, "zone.radius_m", &["found [0, 1], allowed: a number: the radius"]);
    expect(
        &format!("{zone}radius_m = 'x'"),
        5,
        "zone.radius_m",
        &["found 'x', allowed: a number or a pair of numbers"],
    );
    expect(zone, 2, "zone.radius_m", &["found nothing"]);
    expect(&format!("{zone}radius_m = -1"), 5, "zone.radius_m", &["found -1"]);
}

#[test]
fn bad_syntax_has_its_line() {
    let error = error("name = \"a\"\nlegs == 4\n");
    assert_eq!(error.line, Some(2), "{error}");
    let error = parse::<Robot>(Path::new("robot.toml"), "name = \"a\"\nname = \"b\"\n", validate).unwrap_err();
    assert!(error.line == Some(2) && error.rendered.contains("found name a second time"), "{error}");
}

#[test]
fn a_file_that_cannot_be_read_gets_one_line_and_its_kind() {
    let folder = tempfile::tempdir().unwrap();
    let kind = |path: &Path| {
        let error = load(path, validate).unwrap_err();
        assert_eq!(error.rendered.lines().count(), 1, "{error}");
        assert!(error.rendered.contains(&path.display().to_string()), "{error}");
        (error.kind, error.summary)
    };
    assert_eq!(kind(&folder.path().join("none.toml")).0, DocumentErrorKind::Missing);
    assert!(kind(folder.path()).1.contains("directory"));
    let large = folder.path().join("large.toml");
    std::fs::File::create(&large).unwrap().set_len(100_000_000).unwrap();
    assert!(kind(&large).1.contains("found 100000000 bytes, allowed: at most 262144"), "{:?}", kind(&large));
    let latin = folder.path().join("latin.toml");
    std::fs::write(&latin, b"a = 1\nname = \"\xe9\"").unwrap();
    assert!(kind(&latin).1.contains("line 2: found the byte 0xe9"), "{:?}", kind(&latin));
    assert_eq!(kind(&latin).0, DocumentErrorKind::Content);
    if cfg!(unix) {
        assert!(kind(Path::new("/dev/zero")).1.contains("device"));
    }
}

#[test]
fn a_good_document_is_read() {
    let text = "name = \"a\"\nlegs = 4\ngait = \"walk\"\n[[arm]]\nlength_m = 1\n";
    let robot = parse(Path::new("robot.toml"), text, validate).unwrap();
    assert_eq!((robot.legs, robot.gait, robot.arm.len()), (4, Some(Gait::Walk), 1));
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in "\\PC{0,200}") {
        let _ = parse(Path::new("robot.toml"), &text, validate);
    }

    #[test]
    fn no_text_made_of_toml_pieces_makes_it_panic(pieces in prop::collection::vec(prop::sample::select(vec![
        "name", "legs", "gait", "arm", "zone", "=", " ", "\n", "[", "]", "{", "}", "\"", "'", "`", ".", ",", "1", "nan", "\"walk\"",
        "[[arm]]\n", "length_m = ", "mount", "\r\n", "#", "\u{e9}", "shape = \"circle\"", "radius_m = ", "\t", "\0", "`, expected ",
    ]), 0..40)) {
        let _ = parse(Path::new("robot.toml"), &pieces.concat(), validate);
    }
}
