//! What is wrong with a document: everything at once, each with its place and its remedy.

use super::Place;
#[cfg(feature = "cli")]
use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
#[cfg(feature = "cli")]
use serde::Serialize;
use std::cell::RefCell;
use std::fmt;

/// A document's name and text.
#[derive(Clone, Debug)]
pub struct Source {
    name: String,
    text: String,
    /// Where each line begins.
    lines: Vec<usize>,
}

impl Source {
    /// A document of this name and text.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        let text = text.into();
        let breaks = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at + 1);
        let lines = std::iter::once(0).chain(breaks).collect();
        Self { name: name.into(), text, lines }
    }

    /// The name: the path of the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Line and column, both from 1, of a position in the text.
    pub fn line_column(&self, at: usize) -> (usize, usize) {
        let line = self.lines.partition_point(|start| *start <= at).max(1);
        let start = self.lines.get(line - 1).copied().unwrap_or(0);
        let before = self.text.get(start..at).unwrap_or("");
        (line, before.chars().count() + 1)
    }

    /// The bytes of the line in which a position stands.
    #[cfg(feature = "cli")]
    fn line_length(&self, at: usize) -> usize {
        let line = self.lines.partition_point(|start| *start <= at).max(1);
        let start = self.lines.get(line - 1).copied().unwrap_or(0);
        self.lines.get(line).copied().unwrap_or(self.text.len()) - start
    }
}

/// One thing that is wrong.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Problem {
    /// Where; `None` where nothing stands that should.
    pub place: Option<Place>,
    /// The field, as a path: `channel.wheel_speed.period`.
    pub field: String,
    /// What is wrong.
    pub what: String,
    /// What would be right.
    pub help: String,
}

/// Where problems are collected while a document is read.
#[derive(Default, Debug)]
pub struct Log(RefCell<Vec<Problem>>);

impl Log {
    /// Notes a problem.
    pub fn add(&self, problem: Problem) {
        let Problem { place, field, what, help } = problem;
        let problem = Problem { place, field: cut(field), what: cut(what), help: cut(help) };
        self.0.borrow_mut().push(problem);
    }

    /// How many problems were noted.
    pub fn len(&self) -> usize {
        self.0.borrow().len()
    }

    /// Was nothing noted?
    pub fn is_empty(&self) -> bool {
        self.0.borrow().is_empty()
    }

    /// All that was noted, in the order of the text; `None` if nothing was.
    pub fn into_problems(self, source: &Source) -> Option<Problems> {
        let mut list = self.0.into_inner();
        if list.is_empty() {
            return None;
        }
        list.sort_by_key(|problem| problem.place.clone().map_or((0, 0), |place| (place.start, place.end)));
        list.dedup();
        Some(Problems { source: source.clone(), list })
    }
}

/// What is quoted of a document has no end of its own.
fn cut(text: String) -> String {
    if text.chars().count() <= LONGEST_TEXT {
        return text;
    }
    text.chars().take(LONGEST_TEXT).chain(['…']).collect()
}

/// No part of a message is longer.
const LONGEST_TEXT: usize = 300;

/// So many problems are shown to people; the rest is counted.
const MOST_SHOWN: usize = 50;

/// A line of the source is shown up to this length.
#[cfg(feature = "cli")]
const LONGEST_LINE: usize = 400;

/// All that is wrong with a document. Never empty.
#[derive(Clone, Debug)]
pub struct Problems {
    source: Source,
    list: Vec<Problem>,
}

/// A problem in a form for machines.
#[cfg(feature = "cli")]
#[derive(Serialize, Debug)]
struct Entry<'a> {
    file: &'a str,
    line: Option<usize>,
    column: Option<usize>,
    field: &'a str,
    problem: &'a str,
    remedy: &'a str,
}

impl Problems {
    /// The problems, in the order of the text.
    pub fn list(&self) -> &[Problem] {
        &self.list
    }

    #[cfg(feature = "cli")]
    /// A JSON list of objects with `file`, `line`, `column`, `field`, `problem` and `remedy`.
    pub fn to_json(&self) -> serde_json::Value {
        let entries: Vec<_> = self
            .list
            .iter()
            .map(|problem| {
                let at = problem.place.clone().map(|place| self.source.line_column(place.start));
                Entry {
                    file: self.source.name(),
                    line: at.map(|at| at.0),
                    column: at.map(|at| at.1),
                    field: &problem.field,
                    problem: &problem.what,
                    remedy: &problem.help,
                }
            })
            .collect();
        serde_json::json!(entries)
    }

    #[cfg(feature = "cli")]
    /// A report with the lines of the source, for people.
    pub fn render(&self, colour: bool) -> String {
        let theme = if colour {
            miette::GraphicalTheme::unicode()
        } else {
            miette::GraphicalTheme::unicode_nocolor()
        };
        let handler = miette::GraphicalReportHandler::new_themed(theme).with_width(100);
        let mut report = String::new();
        for problem in self.list.iter().take(MOST_SHOWN) {
            let is_long = |place: &Place| self.source.line_length(place.start) > LONGEST_LINE;
            let source = match &problem.place {
                Some(place) if !is_long(place) => {
                    Some(NamedSource::new(self.source.name(), self.source.text().to_owned()))
                }
                _ => None,
            };
            let at = problem.place.as_ref().filter(|_| source.is_none());
            let at = at.map(|place| self.source.line_column(place.start));
            let shown = Shown { problem, source, at };
            // Writing into a string does not fail; a report cut short would still name the field.
            let _ = handler.render_report(&mut report, &shown);
        }
        report.push_str(&self.more());
        report
    }
}

impl Problems {
    /// What is not shown.
    fn more(&self) -> String {
        match self.list.len().saturating_sub(MOST_SHOWN) {
            0 => String::new(),
            more => format!("... and {more} more like these\n"),
        }
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in self.list.iter().take(MOST_SHOWN) {
            write!(f, "{}", self.source.name())?;
            if let Some(place) = &problem.place {
                let (line, column) = self.source.line_column(place.start);
                write!(f, ":{line}:{column}")?;
            }
            writeln!(f, ": {}: {}; {}", problem.field, problem.what, problem.help)?;
        }
        f.write_str(&self.more())
    }
}

impl std::error::Error for Problems {}

#[cfg(feature = "cli")]
struct Shown<'a> {
    problem: &'a Problem,
    /// None if the line is too long to be shown.
    source: Option<NamedSource<String>>,
    /// Line and column, where the line is not shown.
    at: Option<(usize, usize)>,
}

#[cfg(feature = "cli")]
impl fmt::Debug for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(feature = "cli")]
impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.problem.field, self.problem.what)?;
        self.at.map_or(Ok(()), |(line, column)| write!(f, " (line {line}, column {column})"))
    }
}

#[cfg(feature = "cli")]
impl std::error::Error for Shown<'_> {}

#[cfg(feature = "cli")]
impl Diagnostic for Shown<'_> {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        Some(Box::new(&self.problem.help))
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.source.as_ref().map(|source| source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.problem.place.clone().filter(|_| self.source.is_some())?;
        Some(Box::new(std::iter::once(LabeledSpan::at(place, "here"))))
    }
}
