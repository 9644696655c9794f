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
}

impl Source {
    /// A document of this name and text.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), text: text.into() }
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
        let before = self.text.get(..at).unwrap_or(&self.text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
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
        self.0.borrow_mut().push(problem);
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
        for problem in &self.list {
            let shown = Shown {
                problem,
                source: NamedSource::new(self.source.name(), self.source.text().to_owned()),
            };
            // Writing into a string does not fail; a report cut short would still name the field.
            let _ = handler.render_report(&mut report, &shown);
        }
        report
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.list {
            write!(f, "{}", self.source.name())?;
            if let Some(place) = &problem.place {
                let (line, column) = self.source.line_column(place.start);
                write!(f, ":{line}:{column}")?;
            }
            writeln!(f, ": {}: {}; {}", problem.field, problem.what, problem.help)?;
        }
        Ok(())
    }
}

impl std::error::Error for Problems {}

#[cfg(feature = "cli")]
struct Shown<'a> {
    problem: &'a Problem,
    source: NamedSource<String>,
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
        write!(f, "{}: {}", self.problem.field, self.problem.what)
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
        self.problem.place.as_ref().map(|_| &self.source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.problem.place.clone()?;
        Some(Box::new(std::iter::once(LabeledSpan::at(place, "here"))))
    }
}
