//! The house keeps its shape: one direction of imports, small files and functions, equal stems for twins, each foreign
//! library behind its own door. The rules are those of the crate documentation; this file reads the sources as text.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Who may import whom, by top-level module. A new row or entry deserves a second reader.
const MAY_IMPORT: &[(&str, &[&str])] = &[
    ("parameter", &[]),
    ("life", &[]),
    ("document", &["parameter"]),
    ("time", &[]),
    ("geometry", &["parameter"]),
    ("signal", &["geometry", "time"]),
    ("sensor", &["geometry", "parameter", "signal", "document"]),
    ("imaging", &["life", "signal", "sensor", "geometry", "parameter", "time"]),
    // Calibration reads the start of raw pings as imaging's health check does, by the same two functions.
    ("calibration", &["imaging", "signal", "sensor", "parameter"]),
    ("flow", &["signal", "sensor", "geometry", "parameter", "time"]),
    ("detect", &["signal", "sensor", "geometry", "time", "parameter"]),
    ("control", &["signal", "time", "geometry", "parameter"]),
    ("safety", &["signal", "sensor", "time", "parameter"]),
    ("sim", &["signal", "sensor", "geometry", "time", "parameter", "document"]),
    (
        "config",
        &[
            "parameter",
            "document",
            "geometry",
            "signal",
            "sensor",
            "imaging",
            "calibration",
            "flow",
            "control",
            "safety",
            "sim",
            "io",
        ],
    ),
    ("io", &["life", "signal", "sim", "time", "safety", "parameter", "sensor", "geometry"]),
    ("controller_process", &["life", "safety", "io", "signal", "time", "config"]),
    ("cli_controller", &["life", "config", "controller_process"]),
    (
        "service",
        &[
            "life",
            "config",
            "imaging",
            "calibration",
            "flow",
            "control",
            "safety",
            "detect",
            "sim",
            "io",
            "signal",
            "sensor",
            "geometry",
            "time",
            "parameter",
        ],
    ),
    ("view", &["config", "io", "detect", "flow", "signal", "sensor", "geometry", "control", "time", "parameter"]),
    (
        "cli",
        &[
            "view",
            "life",
            "config",
            "imaging",
            "calibration",
            "flow",
            "control",
            "safety",
            "detect",
            "sim",
            "io",
            "signal",
            "sensor",
            "geometry",
            "time",
            "parameter",
            "service",
            "controller_process",
            "cli_controller",
            "document",
        ],
    ),
];

fn sources(root: &str, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(root)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn relative(path: &Path) -> String {
    path.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap_or(path).to_string_lossy().replace('\\', "/")
}

/// Top-level module that a source file belongs to; `None` for `lib.rs`, `main.rs` and the binaries, which may see all.
fn module_of(path: &Path) -> Option<String> {
    let name = relative(path);
    let inner = name.strip_prefix("src/")?;
    let module = inner.split('/').next()?.trim_end_matches(".rs").to_owned();
    // A file of unit tests may reach further, as the test module at the end of a file may.
    let tests = name.ends_with("/tests.rs");
    (!tests && !["lib", "main", "bin"].contains(&module.as_str())).then_some(module)
}

/// Code without comments and without the test module at its end: tests may reach further.
fn code(source: &str) -> String {
    let body = source.split("#[cfg(test)]\nmod tests").next().unwrap_or(source);
    body.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// Modules named after `crate::` in `source`, also inside `use crate::{a, b::c}`.
fn imports(source: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (position, _) in source.match_indices("crate::") {
        if source[..position].ends_with('$') || source[..position].ends_with(|c: char| c.is_alphanumeric() || c == '_')
        {
            continue;
        }
        let rest = &source[position + "crate::".len()..];
        if let Some(list) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut name = String::new();
            for character in list.chars() {
                match character {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => found.push(std::mem::take(&mut name)),
                    _ if depth == 0 => name.push(character),
                    _ => {}
                }
            }
            found.push(name);
        } else {
            found.push(rest.to_owned());
        }
    }
    let first =
        |name: &String| name.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    found.iter().map(first).filter(|name| !name.is_empty()).collect()
}

fn violations(module: &str, source: &str) -> Vec<String> {
    let Some((_, allowed)) = MAY_IMPORT.iter().find(|(name, _)| *name == module) else {
        return vec![format!("{module} has no row in the import table")];
    };
    let bad = imports(source).into_iter().filter(|name| name != module && !allowed.contains(&name.as_str()));
    bad.map(|name| format!("{module} imports {name}")).collect()
}

#[test]
fn imports_go_one_way() {
    let mut wrong = Vec::new();
    for path in sources("src", "rs") {
        if let Some(module) = module_of(&path) {
            let source = code(&text(&path));
            wrong.extend(violations(&module, &source).into_iter().map(|what| format!("{}: {what}", relative(&path))));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_planted_upward_import_is_found() {
    assert_eq!(violations("signal", "use crate::imaging::Imager;"), ["signal imports imaging"]);
    assert_eq!(violations("control", "use crate::{signal::Cues, io::wire};"), ["control imports io"]);
    assert_eq!(violations("sim", "let x = crate::flow::field(1.0);"), ["sim imports flow"]);
    assert!(violations("control", "use crate::{signal::{Cues, Mask}, time::Stamp};").is_empty());
}

#[test]
fn the_import_table_has_no_cycle() {
    let table: BTreeMap<&str, &[&str]> = MAY_IMPORT.iter().copied().collect();
    fn depth<'a>(table: &BTreeMap<&'a str, &'a [&'a str]>, module: &'a str, trail: &mut Vec<&'a str>) {
        assert!(!trail.contains(&module), "cycle: {trail:?} -> {module}");
        trail.push(module);
        for &next in table.get(module).copied().unwrap_or_default() {
            depth(table, next, trail);
        }
        trail.pop();
    }
    for module in table.keys() {
        depth(&table, module, &mut Vec::new());
    }
}

#[test]
fn each_foreign_library_has_its_own_door() {
    let doors: &[(&str, &[&str])] = &[
        ("wgpu", &["src/imaging/gpu/"]),
        ("iceoryx2", &["src/io/"]),
        ("mcap", &["src/io/record/"]),
        ("clap", &["src/cli", "src/main.rs", "src/bin/"]),
        ("axum", &["src/view/"]),
        ("hyper", &["src/view/"]),
        ("tokio", &["src/view/"]),
        (
            "rustfft",
            &[
                "src/imaging/cpu/",
                "src/imaging/plan",
                "src/imaging/direct_path/template",
                "src/sim/",
                "src/cli/plot/heard",
            ],
        ),
    ];
    let mut wrong = Vec::new();
    for path in sources("src", "rs") {
        let (name, source) = (relative(&path), code(&text(&path)));
        for (library, allowed) in doors {
            let named = source.contains(&format!("{library}::")) || source.contains(&format!("use {library}"));
            if named && !allowed.iter().any(|door| name.starts_with(door)) {
                wrong.push(format!("{name} names {library}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn unsafe_code_stays_in_its_three_rooms() {
    for path in sources("src", "rs") {
        let name = relative(&path);
        let rooms = ["src/io/wire", "src/imaging/cpu/simd", "src/imaging/cpu/shared_image.rs"];
        let room = rooms.iter().any(|room| name.starts_with(room));
        let source = code(&text(&path));
        let has = source.lines().any(|line| line.contains("unsafe ") && !line.contains("unsafe_code"));
        assert!(room || !has, "{name} holds unsafe code");
    }
}

#[test]
fn files_stay_under_500_lines() {
    let all = ["src", "tests", "benches"].iter().flat_map(|root| sources(root, "rs"));
    let long: Vec<String> = all
        .chain(sources("shaders", "wgsl"))
        .map(|path| (relative(&path), text(&path).lines().count()))
        .filter(|(_, lines)| *lines > 500)
        .map(|(name, lines)| format!("{name}: {lines} lines"))
        .collect();
    assert!(long.is_empty(), "{}", long.join("\n"));
}

/// Length of every function of formatted source: from its `fn` line to the closing brace at the same indent.
fn function_lengths(source: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = source.lines().collect();
    let mut found = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let indent = line.len() - line.trim_start().len();
        let words = line.trim_start();
        let is_function =
            ["fn ", "pub fn ", "pub(crate) fn ", "pub(super) fn ", "const fn ", "pub const fn ", "unsafe fn "]
                .iter()
                .any(|start| words.starts_with(start));
        if !is_function || words.ends_with(';') || words.ends_with('}') {
            continue;
        }
        let close = format!("{}}}", " ".repeat(indent));
        if let Some(length) = lines[start..].iter().position(|line| *line == close) {
            found.push((words.to_owned(), length + 1));
        }
    }
    found
}

#[test]
fn functions_stay_under_70_lines() {
    let mut long = Vec::new();
    for path in sources("src", "rs") {
        for (function, length) in function_lengths(&text(&path)) {
            if length > 70 {
                long.push(format!("{}: {length} lines: {function}", relative(&path)));
            }
        }
    }
    assert!(long.is_empty(), "{}", long.join("\n"));
    let planted = format!("fn long() {{\n{}}}\n", "    step();\n".repeat(80));
    assert_eq!(function_lengths(&planted)[0].1, 82, "the measure itself must see a long function");
}

#[test]
fn every_stage_has_shader_twin_oracle_and_bench_of_the_same_stem() {
    let oracle: String = sources("tests/common", "rs").iter().map(|path| text(path)).collect();
    let bench = text(&Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/stages.rs"));
    for stem in ["demodulate", "matched_filter", "delay_and_sum", "envelope", "masked_energy"] {
        for file in [format!("shaders/{stem}.wgsl"), format!("src/imaging/cpu/{stem}.rs")] {
            assert!(Path::new(env!("CARGO_MANIFEST_DIR")).join(&file).is_file(), "{file} is missing");
        }
        assert!(oracle.contains(&format!("fn {stem}")), "the oracle has no {stem}");
        assert!(bench.contains(stem), "benches/stages.rs has no {stem}");
    }
}

#[test]
fn every_source_file_opens_with_what_it_is() {
    for path in sources("src", "rs").into_iter().chain(sources("tests", "rs")).chain(sources("benches", "rs")) {
        assert!(text(&path).starts_with("//!"), "{} has no header", relative(&path));
    }
    for path in sources("shaders", "wgsl") {
        assert!(text(&path).starts_with("//"), "{} has no header", relative(&path));
    }
}
