//! Fields by name and type.

use super::{At, Kind, Log, Node, Place, Problem};
use std::cell::RefCell;

/// Why a part of a document is not what a field wants.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Mismatch {
    /// What is wrong.
    pub what: String,
    /// What would be right.
    pub help: String,
}

impl Mismatch {
    /// A mismatch between what stands there and what would be right.
    pub fn new(what: impl Into<String>, help: impl Into<String>) -> Self {
        Self { what: what.into(), help: help.into() }
    }
}

/// A type that a field can have.
pub trait FromNode: Sized {
    /// The value that the node says.
    ///
    /// # Errors
    /// What is wrong with it and what would be right.
    fn from_node(node: &Node) -> Result<Self, Mismatch>;
}

impl FromNode for String {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        match &node.kind {
            Kind::Text(text) => Ok(text.clone()),
            _ => Err(Mismatch::new(format!("{} is not text", node.describe()), "write text in quotes")),
        }
    }
}

impl FromNode for bool {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        match node.kind {
            Kind::Boolean(value) => Ok(value),
            _ => Err(Mismatch::new(
                format!("{} is neither true nor false", node.describe()),
                "write true or false",
            )),
        }
    }
}

/// A number of 64 bits: in any base, or as text with a `0x` prefix (TOML's integers end at 2^63).
impl FromNode for u64 {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let (digits, base) = match &node.kind {
            Kind::Number(text, base) => (text.as_str(), *base),
            Kind::Text(text) => match text.trim().strip_prefix("0x").or(text.trim().strip_prefix("0X")) {
                Some(digits) => (digits, 16),
                None => (text.trim(), 10),
            },
            _ => ("", 10),
        };
        let digits: String = digits.chars().filter(|c| *c != '_').collect();
        Self::from_str_radix(&digits, base).map_err(|_| {
            Mismatch::new(
                format!("{} is not a whole number of at most 64 bits", node.describe()),
                "write a whole number from 0, such as 100 or 0x64",
            )
        })
    }
}

macro_rules! smaller_number {
    ($($number:ty),*) => {$(
        impl FromNode for $number {
            fn from_node(node: &Node) -> Result<Self, Mismatch> {
                let value = u64::from_node(node)?;
                Self::try_from(value).map_err(|_| {
                    Mismatch::new(format!("{value} is too large"), format!("write at most {}", Self::MAX))
                })
            }
        }
    )*};
}
smaller_number!(u8, u16, u32);

/// A table whose fields are being read. Fields that nobody asked for are reported by
/// [`Table::finish`].
#[derive(Debug)]
pub struct Table<'a> {
    entries: &'a [(At<String>, Node)],
    place: Place,
    path: String,
    asked: RefCell<Vec<&'static str>>,
    malformed: RefCell<Vec<&'static str>>,
    refused: RefCell<Vec<&'static str>>,
    log: &'a Log,
}

impl<'a> Table<'a> {
    /// The fields of `node`, which stands at `path`. If it is no table, that is noted and the table is
    /// empty.
    pub fn new(node: &'a Node, path: impl Into<String>, log: &'a Log) -> Self {
        let path = path.into();
        let entries: &[_] = match &node.kind {
            Kind::Table(entries) => entries,
            _ => {
                let what = format!("{} is not a table", node.describe());
                let help = "write named fields, one a line".to_owned();
                log.add(Problem { place: Some(node.place.clone()), field: path.clone(), what, help });
                &[]
            }
        };
        Self {
            entries,
            place: node.place.clone(),
            path,
            asked: RefCell::default(),
            malformed: RefCell::default(),
            refused: RefCell::default(),
            log,
        }
    }

    /// Where the table stands.
    pub fn place(&self) -> Place {
        self.place.clone()
    }

    /// Its path.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// The path of one of its fields.
    pub fn path_of(&self, field: &str) -> String {
        if self.path.is_empty() { field.to_owned() } else { format!("{}.{field}", self.path) }
    }

    /// From here on the table is known by this name.
    pub fn rename(&mut self, path: impl Into<String>) {
        self.path = path.into();
    }

    /// Notes a problem with a field, or with a place in it.
    pub fn problem(&self, field: &str, place: Place, what: impl Into<String>, help: impl Into<String>) {
        let (what, help) = (what.into(), help.into());
        self.log.add(Problem { place: Some(place), field: self.path_of(field), what, help });
    }

    /// Notes a problem with the field if it stands there: it is known, and may not be used.
    pub fn refuse(&self, field: &'static str, what: &str, help: &str) {
        self.refused.borrow_mut().push(field);
        if let Some((key, _)) = self.entries.iter().find(|(key, _)| key.value == field) {
            self.problem(field, key.place.clone(), what, help);
        }
    }

    /// The field as it stands; `None` if it does not.
    pub fn node(&self, field: &'static str) -> Option<&'a Node> {
        let mut asked = self.asked.borrow_mut();
        if !asked.contains(&field) {
            asked.push(field);
        }
        self.entries.iter().find(|(key, _)| key.value == field).map(|(_, node)| node)
    }

    /// Returns whether the field stands there, well formed or not.
    pub fn stands(&self, field: &str) -> bool {
        self.entries.iter().any(|(key, _)| key.value == field)
    }

    /// The fields that stand there and are not what they should be. To say that one of them is missing would be a
    /// second mistake for one.
    pub fn malformed(&self) -> Vec<&'static str> {
        self.malformed.borrow().clone()
    }

    /// Notes that a field is not what it should be.
    pub fn is_malformed(&self, field: &'static str) {
        self.malformed.borrow_mut().push(field);
    }

    /// The field, if it stands there; a mismatch is noted.
    pub fn optional<T: FromNode>(&self, field: &'static str) -> Option<At<T>> {
        let node = self.node(field)?;
        self.convert(field, node)
    }

    /// The field; if it is missing or a mismatch, that is noted.
    pub fn required<T: FromNode>(&self, field: &'static str, help: &str) -> Option<At<T>> {
        match self.node(field) {
            Some(node) => self.convert(field, node),
            None => {
                // Point at the first line of the table, not at all of it.
                let start = self.place.start;
                self.problem(field, start..start, "is missing", help);
                None
            }
        }
    }

    /// The items of the field, a list; empty if it does not stand there. Mismatches are noted.
    pub fn list<T: FromNode>(&self, field: &'static str) -> Vec<At<T>> {
        let Some(items) = self.nodes(field) else { return Vec::new() };
        items.iter().filter_map(|item| self.convert(field, item)).collect()
    }

    /// The items of the field as they stand; `None` if it does not or is no list, which is noted.
    pub fn nodes(&self, field: &'static str) -> Option<&'a [Node]> {
        let node = self.node(field)?;
        match &node.kind {
            Kind::Array(items) => Some(items),
            _ => {
                let what = format!("{} is not a list", node.describe());
                self.malformed.borrow_mut().push(field);
                self.problem(field, node.place.clone(), what, "write a list in brackets: [ ... ]");
                None
            }
        }
    }

    /// Reads the table in the field, with `read`.
    pub fn entry<T>(&self, field: &'static str, read: fn(&Table<'_>) -> T) -> Option<T> {
        self.node(field).map(|node| read(&Table::new(node, self.path_of(field), self.log)))
    }

    /// Reads each of the tables in the field, with `read`.
    pub fn entries<T>(&self, field: &'static str, mut read: impl FnMut(&Table<'_>) -> T) -> Vec<T> {
        let items = self.nodes(field).unwrap_or_default();
        let read_one = |(at, item): (usize, &Node)| {
            let mut table = Table::new(item, self.path_of(&format!("{field}[{at}]")), self.log);
            // From its second field on an entry is known by its name, if it has one.
            if let Some(Node { kind: Kind::Text(name), .. }) = table.node("name") {
                table.rename(self.path_of(&format!("{field}.{name}")));
            }
            read(&table)
        };
        items.iter().enumerate().map(read_one).collect()
    }

    fn convert<T: FromNode>(&self, field: &'static str, node: &Node) -> Option<At<T>> {
        match T::from_node(node) {
            Ok(value) => Some(At { value, place: node.place.clone() }),
            Err(Mismatch { what, help }) => {
                self.malformed.borrow_mut().push(field);
                self.problem(field, node.place.clone(), what, help);
                None
            }
        }
    }

    /// Notes every field that nobody asked for.
    pub fn finish(&self) {
        let (asked, refused) = (self.asked.borrow(), self.refused.borrow());
        for (key, _) in self.entries {
            let name = key.value.as_str();
            if !asked.contains(&name) && !refused.contains(&name) {
                let help = match nearest(&key.value, asked.iter().copied()) {
                    Some(name) => format!("did you mean `{name}`?"),
                    None => format!("the fields here are: {}", asked.join(", ")),
                };
                self.problem(&key.value, key.place.clone(), "is not a field that is known here", help);
            }
        }
    }
}

/// The candidate that looks most like `name`, if one is close enough to be meant.
pub fn nearest<'c>(name: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let limit = name.chars().count().div_ceil(3).max(1);
    candidates
        .into_iter()
        .map(|candidate| (edits(name, candidate), candidate))
        .filter(|(distance, _)| *distance <= limit)
        .min()
        .map(|(_, candidate)| candidate)
}

/// Levenshtein's distance.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    #[test]
    fn everything_wrong_is_found_in_one_pass() {
        let source = Source::new("a.toml", "lenght = 4\nname = 3\nflag = 'yes'\n");
        let log = Log::default();
        let node = Node::parse(&source, &log);
        let table = Table::new(&node, "channel", &log);
        assert_eq!(table.required::<String>("name", "give it a name"), None);
        assert_eq!(table.required::<u8>("length", "0..=8"), None);
        assert_eq!(table.optional::<bool>("flag"), None);
        table.finish();
        let problems = log.into_problems(&source).unwrap();
        let text = problems.to_string();
        assert_eq!(problems.list().len(), 4, "{text}");
        assert!(text.contains("a.toml:1:1: channel.lenght: is not a field"), "{text}");
        assert!(text.contains("did you mean `length`?"), "{text}");
        assert!(text.contains("a.toml:2:8: channel.name: the number 3 is not text"), "{text}");
    }

    #[test]
    fn json_has_places_too() {
        let source = Source::new("a.json", "{\n  \"period\": -3\n}");
        let log = Log::default();
        let node = Node::parse(&source, &log);
        let table = Table::new(&node, "", &log);
        assert_eq!(table.optional::<u32>("period"), None);
        let problems = log.into_problems(&source).unwrap();
        assert!(problems.to_string().starts_with("a.json:2:13: period: "), "{problems}");
    }

    #[test]
    fn names_that_are_meant() {
        assert_eq!(nearest("peroid", ["period", "phase"]), Some("period"));
        assert_eq!(nearest("colour", ["period", "phase"]), None);
    }
}
