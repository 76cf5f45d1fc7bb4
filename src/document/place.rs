//! Where in a document a key stands, and which key stands at a place.
//!
//! Goes in: the text, a dotted key (`sensor[1].mount.distance_m`) or a span of bytes. Comes out: a [`Place`]. Reads the
//! document a second time; only ever called for an error.

use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// A key and the bytes it concerns.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Place {
    /// Dotted key, if known.
    pub(super) key: Option<String>,
    /// Bytes of the value, of the key or of the nearest enclosing table.
    pub(super) span: Option<Range<usize>>,
}

/// One key or list entry of the document.
#[derive(Debug)]
pub(super) struct Node {
    /// Dotted path from the root; empty for the root.
    pub(super) path: String,
    /// Bytes of the key itself; none for the root and for entries of lists.
    pub(super) key_span: Option<Range<usize>>,
    /// Bytes of the value; for a table its header.
    pub(super) value_span: Range<usize>,
    /// Whether the value is a table.
    pub(super) is_table: bool,
}

/// All keys of a document, parents before children.
#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
}

impl Tree {
    /// Reads what can be read of `text`.
    pub(super) fn parse(text: &str) -> Self {
        let (root, _) = DeTable::parse_recoverable(text);
        let mut tree = Tree::default();
        tree.add_table(String::new(), root.get_ref());
        tree
    }

    fn add_table(&mut self, path: String, table: &DeTable<'_>) {
        for (key, value) in table {
            let name = key.get_ref().as_ref();
            let path = if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
            self.add_value(path, Some(key.span()), value);
        }
    }

    fn add_value(&mut self, path: String, key_span: Option<Range<usize>>, value: &toml::Spanned<DeValue<'_>>) {
        let is_table = value.get_ref().is_table();
        self.nodes.push(Node { path: path.clone(), key_span, value_span: value.span(), is_table });
        match value.get_ref() {
            DeValue::Table(table) => self.add_table(path, table),
            DeValue::Array(array) => {
                for (index, entry) in array.iter().enumerate() {
                    self.add_value(format!("{path}[{index}]"), None, entry);
                }
            }
            _ => {}
        }
    }

    fn node(&self, path: &str) -> Option<&Node> {
        self.nodes.iter().find(|node| node.path == path)
    }

    /// The place of a dotted key; where the document does not hold it, that of the nearest table or list around it.
    pub(super) fn of_key(&self, key: &str) -> Place {
        let mut path = key;
        loop {
            if let Some(node) = self.node(path) {
                return Place { key: Some(key.to_owned()), span: Some(node.value_span.clone()) };
            }
            match path.rfind(['.', '[']) {
                Some(cut) => path = &path[..cut],
                None => return Place { key: Some(key.to_owned()), span: None },
            }
        }
    }

    /// The key whose name or value spans exactly these bytes, else the innermost one around them.
    pub(super) fn at_span(&self, span: &Range<usize>) -> Option<&Node> {
        let exact = |node: &&Node| node.key_span.as_ref() == Some(span) || &node.value_span == span;
        let around = |node: &&Node| node.value_span.start <= span.start && span.end <= node.value_span.end;
        self.nodes.iter().rev().find(exact).or_else(|| self.nodes.iter().rev().find(around))
    }

    /// The last key that begins before byte `start`, on the same line.
    pub(super) fn on_line_before(&self, text: &str, start: usize) -> Option<String> {
        let line_start = text.get(..start)?.rfind('\n').map_or(0, |newline| newline + 1);
        let begins = |node: &Node| node.key_span.as_ref().map(|span| span.start);
        let on_line = |node: &&Node| begins(node).is_some_and(|begin| (line_start..=start).contains(&begin));
        self.nodes.iter().filter(on_line).max_by_key(|node| begins(node)).map(|node| node.path.clone())
    }

    /// The bytes of the key `name` in the table at `path`.
    pub(super) fn key_in(&self, path: &str, name: &str) -> Option<Range<usize>> {
        self.node(&joined(path, name)).and_then(|node| node.key_span.clone())
    }
}

/// The path of a key in a table.
pub(super) fn joined(table: &str, key: &str) -> String {
    if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
}

/// The path of the table or list that holds a key.
pub(super) fn parent(path: &str) -> &str {
    path.rfind(['.', '[']).map_or("", |cut| &path[..cut])
}
