//! Why a command ended early: one line, with what to do, and an exit code.

use std::fmt;
use std::process::ExitCode;

use cosmic_log::LogError;

/// Why a command ended early.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Failure {
    line: Option<String>,
    code: u8,
}

/// Nothing was heard of what was asked for, or something is wrong with the segment.
pub(crate) const FOUND: u8 = 1;
/// An option, a file or a value is wrong.
const INPUT: u8 = 2;
/// The segment cannot be reached, or does not answer.
const LINK: u8 = 3;

impl Failure {
    /// Something that was given is wrong.
    pub(crate) fn input(line: impl Into<String>) -> Self {
        Self { line: Some(line.into()), code: INPUT }
    }

    /// The segment cannot be reached, or does not answer.
    pub(crate) fn link(line: impl Into<String>) -> Self {
        Self { line: Some(line.into()), code: LINK }
    }

    /// Who read the output has closed it: no fault of anybody's.
    pub(crate) const fn closed() -> Self {
        Self { line: None, code: 0 }
    }

    /// Prints the line, and says with which code the program ends.
    pub(crate) fn report(self) -> ExitCode {
        if let Some(line) = self.line {
            eprintln!("cosmic: {line}");
        }
        ExitCode::from(self.code)
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.line.as_deref().unwrap_or_default())
    }
}

impl From<LogError> for Failure {
    fn from(error: LogError) -> Self {
        if error.is_closed() { Self::closed() } else { Self::input(error.to_string()) }
    }
}
