//! Contract: what the README says of layouts, errors, commands and files is what the program does. Generated parts are
//! written by `NOCTULE_BLESS=1 cargo test --release --test readme -- --test-threads 1`: all write the same file.

use noctule::config::Config;
use noctule::io::topics::Topic;
use noctule::io::wire::WireType;
use noctule::io::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, RawHeader, VelocityCommand, VelocityInput,
};
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::signal::SampleFormat;
use noctule::sim::World;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn readme() -> String {
    std::fs::read_to_string(root().join("README.md")).expect("README.md")
}

/// The part of the README between two markers, or with `NOCTULE_BLESS=1` the new text put there.
fn held(name: &str, expected: &str) {
    let page = readme();
    let begin = page.find(&format!("<!-- {name}: begin")).expect("begin marker");
    let start = begin + page[begin..].find("-->").expect("marker ends") + "-->\n".len();
    let end = start + page[start..].find(&format!("<!-- {name}: end -->")).expect("end marker");
    if std::env::var_os("NOCTULE_BLESS").is_some() {
        let page = format!("{}{expected}{}", &page[..start], &page[end..]);
        std::fs::write(root().join("README.md"), page).expect("README.md is written");
        return;
    }
    assert_eq!(&page[start..end], expected, "the README's part {name} is old: NOCTULE_BLESS=1 writes it anew");
}

fn table<T: WireType>(page: &mut String) {
    let _ = writeln!(
        page,
        "\n**{}** ({} bytes)\n\n| offset | type | field | meaning |\n|---|---|---|---|",
        T::TYPE_NAME,
        size_of::<T>()
    );
    for field in T::FIELDS {
        let name = field.primitive.name();
        let kind = if field.count == 1 { name.to_owned() } else { format!("{name}[{}]", field.count) };
        let _ = writeln!(page, "| {} | {kind} | `{}` | {} |", field.offset, field.name, field.doc);
    }
}

#[test]
fn the_layouts_on_the_page_are_those_of_the_types() {
    let mut page = String::from("| service | payload | header | from, to |\n|---|---|---|---|\n");
    let sensors = vec!["<name>".to_owned()];
    let formats = [SampleFormat::Pdm, SampleFormat::PcmI16, SampleFormat::PcmF32];
    let mut topics: Vec<Topic> = formats.iter().map(|format| Topic::raw("<name>", *format)).collect();
    topics.extend(Topic::all(&sensors, SampleFormat::Pdm).into_iter().skip(1));
    for topic in topics {
        let payload = match topic.payload.slice {
            true => format!("[{}]", topic.payload.type_name),
            false => topic.payload.type_name.to_owned(),
        };
        let header = topic.header.map_or("", |header| header.type_name);
        let _ = writeln!(page, "| `{}` | {payload} | {header} | {} |", topic.name, topic.route);
    }
    table::<RawHeader>(&mut page);
    table::<EnergyscapeHeader>(&mut page);
    table::<VelocityCommand>(&mut page);
    table::<PlatformVelocity>(&mut page);
    table::<VelocityInput>(&mut page);
    table::<OperatorRequest>(&mut page);
    table::<Odometry>(&mut page);
    table::<Cues>(&mut page);
    table::<Health>(&mut page);
    held("topics", &page);
}

#[test]
fn the_example_of_an_error_is_a_real_one() {
    let text = "[control.collision_avoidance]\nthreshhold = 0.02\n";
    let error = Config::parse(text, Path::new("robot.toml")).expect_err("a misspelt key");
    held("error", &format!("```text\n{error}\n```\n"));
}

/// One of the forty checks, as `docs/safety_checks.toml` describes it.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Check {
    number: u8,
    fault: String,
    injected: String,
    tests: Vec<String>,
    controls: Vec<String>,
}

/// A line of `docs/safety_figures.jsonl`, which `.ci/full` measures.
#[derive(serde::Deserialize)]
struct Figure {
    check: u8,
    what: String,
    found: String,
    bar: String,
    trials: usize,
    full: bool,
}

fn checks() -> Vec<Check> {
    let text = std::fs::read_to_string(root().join("docs/safety_checks.toml")).expect("docs/safety_checks.toml");
    let mut tables: toml::Table = toml::from_str(&text).expect("TOML");
    let checks = tables.remove("check").expect("[[check]]");
    checks.try_into().expect("the keys of a check")
}

fn figures() -> Vec<Figure> {
    let text = std::fs::read_to_string(root().join("docs/safety_figures.jsonl")).expect("docs/safety_figures.jsonl");
    text.lines().map(|line| serde_json::from_str(line).expect("a figure")).collect()
}

/// Names as `file::function` in code, after it was seen that there is such a function in `tests/<file>.rs` or in a module beside it.
fn existing(names: &[String]) -> String {
    let shown = names.iter().map(|name| {
        let (file, function) = name.split_once("::").unwrap_or_else(|| panic!("{name} is no file::function"));
        let beside = [format!("tests/{file}.rs"), format!("tests/{file}/mod.rs"), format!("src/{file}.rs")];
        let texts = beside.iter().filter_map(|path| std::fs::read_to_string(root().join(path)).ok());
        let found = texts.into_iter().any(|text| text.contains(&format!("fn {function}(")));
        assert!(found, "there is no function {function} in tests/{file}.rs");
        format!("`{name}`")
    });
    shown.collect::<Vec<_>>().join("<br>")
}

#[test]
fn every_one_of_the_forty_checks_has_its_row_with_figures_and_tests_that_exist() {
    let (checks, figures) = (checks(), figures());
    let numbers: Vec<u8> = checks.iter().map(|check| check.number).collect();
    assert_eq!(numbers, (1..=40).collect::<Vec<u8>>());
    let mut page = String::from(
        "| # | fault | how injected | figures: found (bar), trials | test | negative control |\n|---|---|---|---|---|---|\n",
    );
    for check in &checks {
        let own = figures.iter().filter(|figure| figure.check == check.number);
        let told: Vec<String> = own
            .map(|figure| {
                let share = if figure.full { "" } else { " of a plain run" };
                format!("{}: **{}** ({}), {} trials{share}", figure.what, figure.found, figure.bar, figure.trials)
            })
            .collect();
        assert!(!told.is_empty(), "check {} has no figure", check.number);
        assert!(!check.tests.is_empty(), "check {}", check.number);
        // A check without a negative control says so on the page.
        let controls = if check.controls.is_empty() { "none".to_owned() } else { existing(&check.controls) };
        let tests = existing(&check.tests);
        let Check { number, fault, injected, .. } = check;
        let _ = writeln!(page, "| {number} | {fault} | {injected} | {} | {tests} | {controls} |", told.join("<br>"));
    }
    held("checks", &page);
}

/// What a heading is linked by: small letters, hyphens for spaces, no punctuation.
fn anchor(heading: &str) -> String {
    let words = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = words.chars().filter(|letter| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_'));
    kept.map(|letter| if letter == ' ' { '-' } else { letter }).collect()
}

#[test]
fn the_world_on_the_page_is_one_and_every_key_of_a_world_has_its_row() {
    let page = readme();
    let start = page.find("```toml\nwaypoints").expect("an example of a world") + "```toml\n".len();
    let text = &page[start..start + page[start..].find("```").expect("the example ends")];
    let world = World::parse(Path::new("README.md"), text).expect("the README's world");
    let has_all = !(world.walls.is_empty() || world.pillars.is_empty() || world.movers.is_empty());
    assert!(has_all && !world.waypoints.is_empty(), "the example has one of everything");
    let section = &page[page.find("### World files").expect("the section")..];
    let rows: String = section.lines().filter(|line| line.starts_with("| `")).collect();
    let toml::Value::Table(keys) = toml::Value::try_from(&world).expect("a world is TOML") else { panic!("no table") };
    for (key, value) in keys {
        let parts = match &value {
            toml::Value::Array(items) => items.first().and_then(toml::Value::as_table),
            toml::Value::Table(table) if key == "start" => Some(table),
            _ => None,
        };
        let named = if value.is_array() { format!("[[{key}]]") } else { format!("[{key}]") };
        match parts {
            Some(parts) => parts.keys().for_each(|part| {
                let row = section.lines().any(|line| line.starts_with(&format!("| `{named}")) && line.contains(part));
                assert!(row, "{named} {part} has no row");
            }),
            None => assert!(rows.contains(&format!("`{key}`")), "{key} has no row"),
        }
    }
}

#[test]
fn every_file_that_the_page_names_is_there() {
    let page = readme();
    let anchors: Vec<String> = page.lines().filter(|line| line.starts_with('#')).map(anchor).collect();
    for target in page.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
        match target.strip_prefix('#') {
            Some(wanted) => assert!(anchors.iter().any(|anchor| anchor == wanted), "the README links #{wanted}"),
            None if target.starts_with("http") => {}
            None => assert!(root().join(target).exists(), "the README links {target}"),
        }
    }
    for test in page.split("--test ").skip(1).filter_map(|rest| rest.split(['`', ' ', '\n', ')']).next()) {
        assert!(root().join(format!("tests/{test}.rs")).is_file(), "the README names the test {test}");
    }
}
