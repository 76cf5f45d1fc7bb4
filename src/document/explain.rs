//! Turns a deserializer's message into "KEY: found X, allowed: Y", with the nearest valid key for an unknown one.
//!
//! Goes in: the error, the text and its keys. Comes out: a sentence, its place, and a line of help. A message that is not
//! known here is passed on as it is, never lost.

use super::place::{Place, Tree, joined, parent};
use std::ops::Range;

/// A sentence about a place.
pub(super) struct Told {
    pub(super) place: Place,
    pub(super) summary: String,
    pub(super) help: Vec<String>,
}

/// The sentence for text that is no TOML.
pub(super) fn syntax(error: &toml::de::Error, text: &str) -> Told {
    let (what, allowed) = error.message().split_once(", expected ").unwrap_or((error.message(), ""));
    let span = error.span();
    let summary = if what.starts_with("duplicate key") {
        format!("found {} a second time, allowed: each key once", found_text(text, span.as_ref(), false))
    } else if what.contains("recurs") {
        "found tables or lists nested too deep, allowed: 80 levels".to_owned()
    } else {
        format!("found {what}, allowed: {}", if allowed.is_empty() { "a TOML document" } else { allowed })
    };
    let key = span.as_ref().and_then(|span| Tree::parse(text).on_line_before(text, span.start));
    Told { place: Place { key, span }, summary, help: Vec::new() }
}

/// The sentence for TOML that does not fit the type.
pub(super) fn refusal(error: &toml::de::Error, text: &str, tree: &Tree) -> Told {
    let message = error.message();
    // The root's span is the whole text; to point at all of it would be to point at nothing.
    let span = error.span().filter(|span| *span != (0..text.len()));
    let node = span.as_ref().and_then(|span| tree.at_span(span));
    let path = node.map_or(String::new(), |node| node.path.clone());
    let in_table = node.is_none_or(|node| node.is_table);
    if let Some((key, expected)) = split_quoted(message, "unknown field `") {
        return unknown_key(&key, expected, &path, in_table, span, tree);
    }
    if let Some((value, expected)) = split_quoted(message, "unknown variant `") {
        let allowed = quoted(expected);
        return Told {
            place: Place { key: Some(path), span },
            summary: format!("found \"{value}\", allowed: {}", list(&allowed, "\"")),
            help: nearest(&value, &allowed),
        };
    }
    if let Some((key, _)) = split_quoted(message, "missing field `") {
        let key = joined(&path, &key);
        return Told {
            place: Place { key: Some(key), span },
            summary: "found nothing, allowed: a value, for this key has no default".to_owned(),
            help: Vec::new(),
        };
    }
    if let Some(told) = parameter(message, &path, span.clone(), tree) {
        return told;
    }
    let found = found_text(text, span.as_ref(), in_table);
    let summary = match message.rsplit_once(", expected ") {
        Some(("wanted string or table", _)) | None if message == "wanted string or table" => {
            format!("found {found}, allowed: a string")
        }
        Some((what, expected)) if what.starts_with("invalid ") => {
            format!("found {found}, allowed: {}", plain_type(expected))
        }
        _ => message.to_owned(),
    };
    let mut help = Vec::new();
    if message.ends_with("expected a sequence") && found == "a table" {
        help.push(format!("a list of tables is written [[{path}]]"));
    }
    Told { place: Place { key: Some(path), span }, summary, help }
}

fn unknown_key(key: &str, expected: &str, path: &str, in_table: bool, span: Option<Range<usize>>, tree: &Tree) -> Told {
    // The error stands either on the unknown key itself or, where a whole table was judged, on that table.
    let on_table = in_table && tree.key_in(path, key).is_some();
    let table = if on_table || path.is_empty() { path } else { parent(path) };
    let span = if on_table { tree.key_in(table, key) } else { span };
    let allowed = quoted(expected);
    let home = if table.is_empty() { String::new() } else { format!(" in {table}") };
    let summary = match allowed.is_empty() {
        true => format!("found an unknown key{home}, allowed: no key at all"),
        false => format!("found an unknown key{home}, allowed: {}", list(&allowed, "`")),
    };
    Told { place: Place { key: Some(joined(table, key)), span }, summary, help: nearest(key, &allowed) }
}

/// A message that is a [`crate::parameter::ParameterError`] raised while the table at `path` was read.
fn parameter(message: &str, path: &str, span: Option<Range<usize>>, tree: &Tree) -> Option<Told> {
    let (key, rest) = message.split_once(": found ")?;
    rest.contains(", allowed: ").then_some(())?;
    let key = joined(path, key);
    let place = tree.of_key(&key);
    let span = place.span.or(span);
    Some(Told { place: Place { key: Some(key), span }, summary: format!("found {rest}"), help: Vec::new() })
}

/// Splits "PREFIX`name` and the rest" after the prefix.
fn split_quoted<'m>(message: &'m str, prefix: &str) -> Option<(String, &'m str)> {
    let rest = message.strip_prefix(prefix)?;
    // The name comes from the file and may hold back quotes itself; what follows it never does before ", expected".
    let end = rest.find("`, expected ").or_else(|| rest.find("`, there are no ")).or_else(|| rest.rfind('`'))?;
    Some((rest[..end].to_owned(), &rest[end + 1..]))
}

/// The names between back quotes.
fn quoted(text: &str) -> Vec<String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

fn list(names: &[String], quote: &str) -> String {
    names.iter().map(|name| format!("{quote}{name}{quote}")).collect::<Vec<_>>().join(", ")
}

/// A line of help naming the allowed name most like `found`, if one is like it at all.
fn nearest(found: &str, allowed: &[String]) -> Vec<String> {
    let name = crate::parameter::nearest(found, allowed.iter().map(String::as_str));
    name.map(|name| format!("the nearest is `{name}`")).into_iter().collect()
}

/// The value as the file has it, shortened.
fn found_text(text: &str, span: Option<&Range<usize>>, is_table: bool) -> String {
    let Some(source) = span.filter(|_| !is_table).and_then(|span| text.get(span.clone())) else {
        return "a table".to_owned();
    };
    let first_line = source.lines().next().unwrap_or_default().trim();
    let short: String = first_line.chars().take(60).collect();
    if short.len() < source.trim().len() { format!("{short} ...") } else { short }
}

/// A Rust type's name in words.
fn plain_type(expected: &str) -> String {
    let words = match expected {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "a boolean" => "true or false",
        "a string" | "path string" | "str" => "a string",
        "a sequence" => "a list: [...]",
        other if other.starts_with("struct ") || other == "a map" => "a table",
        other if other.starts_with("an array of length ") => {
            return format!("{} values", other.replace("an array of length ", "a list of "));
        }
        other => other,
    };
    words.to_owned()
}
