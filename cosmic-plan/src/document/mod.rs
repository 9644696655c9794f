//! Input documents, TOML or JSON, as a tree whose parts know where they stand in the text.
//!
//! A reader that stops at the first error makes its user run it once for every error. So documents
//! are parsed to a tree of [`Node`]s first; a [`Table`] then hands out fields by name and type and
//! writes every mismatch, missing field and unknown field into one [`Log`], with its place, what is
//! wrong and what would be right.

pub mod file;
mod parse;
mod problem;
mod table;

pub use problem::{Log, Problem, Problems, Source};
pub use table::{FromNode, Mismatch, Table, nearest};

/// A range of bytes in the source text.
pub type Place = std::ops::Range<usize>;

/// A value and where it stands.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct At<T> {
    /// The value.
    pub value: T,
    /// Where it stands.
    pub place: Place,
}

/// A part of a document.
#[derive(Clone, Debug)]
pub struct Node {
    /// Where it stands.
    pub place: Place,
    /// What it is.
    pub kind: Kind,
}

/// What a part of a document is.
#[derive(Clone, Debug)]
pub enum Kind {
    /// Named fields, in the order of the text where it is kept.
    Table(Vec<(At<String>, Node)>),
    /// A list.
    Array(Vec<Node>),
    /// A string.
    Text(String),
    /// A number as it was written, and its base (2, 8, 10 or 16; the prefix is cut off).
    Number(String, u32),
    /// A truth value.
    Boolean(bool),
    /// Something that no field accepts, by name.
    Other(&'static str),
}

impl Node {
    /// Parses a document: JSON if the first character is `{` or the name ends in `.json`, else TOML.
    ///
    /// Syntax errors are written into the log; what could be read is returned.
    pub fn parse(source: &Source, log: &Log) -> Self {
        if source.name().ends_with(".json") || source.text().trim_start().starts_with('{') {
            parse::json(source.text(), log)
        } else {
            parse::toml(source.text(), log)
        }
    }

    /// The kind in words, for messages.
    pub fn describe(&self) -> String {
        match &self.kind {
            Kind::Table(_) => "a table".to_owned(),
            Kind::Array(_) => "a list".to_owned(),
            Kind::Text(text) => format!("{text:?}"),
            Kind::Number(text, _) => format!("the number {text}"),
            Kind::Boolean(value) => format!("{value}"),
            Kind::Other(what) => (*what).to_owned(),
        }
    }
}
