//! Contract: `docs/configuration.md` is what `noctule config --reference` prints, and every default on it is one that the reader
//! takes. `NOCTULE_BLESS=1 cargo test --release --test reference` writes it.

use noctule::config::{Config, reference};
use std::path::Path;

#[test]
fn the_page_is_the_generated_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/configuration.md");
    let page = reference();
    if std::env::var_os("NOCTULE_BLESS").is_some() {
        std::fs::write(&path, &page).expect("written");
    }
    let held = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(held, page, "docs/configuration.md is old: NOCTULE_BLESS=1 writes it anew");
}

#[test]
fn every_default_on_the_page_is_taken_by_the_reader() {
    let (mut section, mut count) = (String::new(), 0);
    for line in reference().lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            section = heading.trim_matches('`').to_owned();
        }
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        let [key, _, default, ..] = cells.as_slice() else { continue };
        let Some(value) = default.strip_prefix('`').and_then(|text| text.strip_suffix('`')) else { continue };
        if !section.starts_with('[') || section.starts_with("[[") || value.contains("shapes") {
            continue;
        }
        let text = format!("{section}\n{} = {value}\n", key.trim_matches('`'));
        Config::parse(&text, Path::new("robot.toml")).unwrap_or_else(|error| panic!("{text}: {error}"));
        count += 1;
    }
    assert!(count > 60, "{count}");
}
