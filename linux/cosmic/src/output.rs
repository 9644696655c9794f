//! Printing: tables and lines for people, JSON for machines.

use std::io::{self, IsTerminal as _, Write};

use serde::Serialize;

use crate::failure::Failure;

/// Standard output.
pub(crate) struct Output {
    out: io::BufWriter<io::Stdout>,
    json: bool,
    colour: bool,
    is_terminal: bool,
}

/// How a word is set off, on a terminal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Style {
    Plain,
    Bold,
    Dim,
    Good,
    Warning,
    Bad,
}

impl Style {
    const fn code(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Bold => "1",
            Self::Dim => "2",
            Self::Good => "32",
            Self::Warning => "33",
            Self::Bad => "1;31",
        }
    }
}

/// A cell of a table.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Cell {
    text: String,
    style: Style,
    right: bool,
}

impl Cell {
    pub(crate) fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), style: Style::Plain, right: false }
    }

    /// `-` for nothing.
    pub(crate) fn or_dash(text: Option<impl Into<String>>) -> Self {
        text.map_or_else(|| Self::new("-").styled(Style::Dim), Self::new)
    }

    pub(crate) fn number(text: impl ToString) -> Self {
        Self { right: true, ..Self::new(text.to_string()) }
    }

    pub(crate) fn styled(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

impl Output {
    pub(crate) fn new(json: bool) -> Self {
        let stdout = io::stdout();
        let is_terminal = stdout.is_terminal();
        let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        let colour = is_terminal && !refused && !dumb;
        Self { out: io::BufWriter::new(stdout), json, colour, is_terminal }
    }

    /// Returns whether machines read this.
    pub(crate) const fn json(&self) -> bool {
        self.json
    }

    /// Text with a style, where colours are wanted.
    pub(crate) fn styled(&self, text: &str, style: Style) -> String {
        match style {
            Style::Plain => text.to_owned(),
            _ if !self.colour => text.to_owned(),
            style => format!("\x1b[{}m{text}\x1b[0m", style.code()),
        }
    }

    /// One line.
    pub(crate) fn line(&mut self, line: &str) -> Result<(), Failure> {
        writeln!(self.out, "{line}").map_err(closed)?;
        // A person sees it now, and who reads a pipe at the latest when nothing more comes.
        if self.is_terminal { self.flush() } else { Ok(()) }
    }

    /// One value on a line.
    pub(crate) fn value(&mut self, value: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string(value).map_err(|error| Failure::input(error.to_string()))?;
        self.line(&text)
    }

    /// One value that is all there is.
    pub(crate) fn whole(&mut self, value: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(value).map_err(|error| Failure::input(error.to_string()))?;
        self.line(&text)
    }

    /// A table, as wide as its cells.
    pub(crate) fn table(&mut self, heads: &[&str], rows: &[Vec<Cell>]) -> Result<(), Failure> {
        let width = |column: usize| {
            let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.text.chars().count());
            cells.chain([heads[column].chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..heads.len()).map(width).collect();
        let right =
            |column: usize| rows.first().and_then(|row| row.get(column)).is_some_and(|cell| cell.right);
        let heads = heads.iter().enumerate().map(|(column, head)| {
            let cell = if right(column) { Cell::number(head) } else { Cell::new(*head) };
            cell.styled(Style::Bold)
        });
        let heads: Vec<Cell> = heads.collect();
        for row in std::iter::once(&heads).chain(rows) {
            let cells = row.iter().zip(&widths).map(|(cell, width)| self.padded(cell, *width));
            let line = cells.collect::<Vec<_>>().join("  ");
            self.line(line.trim_end())?;
        }
        Ok(())
    }

    fn padded(&self, cell: &Cell, width: usize) -> String {
        let padding = " ".repeat(width.saturating_sub(cell.text.chars().count()));
        let text = self.styled(&cell.text, cell.style);
        if cell.right { padding + &text } else { text + &padding }
    }

    /// All that was printed is out.
    pub(crate) fn flush(&mut self) -> Result<(), Failure> {
        self.out.flush().map_err(closed)
    }
}

/// A reader that closed the pipe does not want the rest.
fn closed(error: io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::closed(),
        _ => Failure::input(format!("the output cannot be written: {error}")),
    }
}

/// A span of nanoseconds, short: `12.3 ms`.
pub(crate) fn short(ns: u64) -> String {
    match ns {
        0..1_000 => format!("{ns} ns"),
        1_000..1_000_000 => format!("{:.0} µs", ns as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} ms", ns as f64 / 1e6),
        _ => format!("{:.1} s", ns as f64 / 1e9),
    }
}

/// The same with a sign.
pub(crate) fn signed(ns: i64) -> String {
    let sign = if ns < 0 { "-" } else { "" };
    format!("{sign}{}", short(ns.unsigned_abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_short() {
        let spans = [950, 2_600, 1_500_000, 2_000_000_000].map(short);
        assert_eq!(spans, ["950 ns", "3 µs", "1.5 ms", "2.0 s"]);
        assert_eq!(signed(-2_500_000), "-2.5 ms");
    }
}
