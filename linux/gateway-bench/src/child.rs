//! Processes that are measured: this program again, in a role. Each is asked by a line on its standard input, answers with
//! a line of JSON, and ends with its input.

use std::io::{BufRead as _, BufReader, Lines, Write as _};
use std::process::{Child as Process, ChildStdout, Command, Stdio};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::failed::Failed;

/// A process that is measured. It ends when this is dropped.
pub struct Child {
    role: String,
    process: Process,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Drop for Child {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Child {
    /// Starts this program in a role, and waits until it has taken it.
    ///
    /// # Errors
    /// It cannot be started, or ends.
    pub fn start(role: &str, arguments: &[String]) -> Result<Self, Failed> {
        let program = std::env::current_exe().map_err(Failed::at("where am I?"))?;
        let mut command = Command::new(program);
        command.arg(ROLE).arg(role).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().map_err(Failed::at(role))?;
        let output = process.stdout.take();
        let output = output.ok_or_else(|| Failed(format!("{role}: it has no output")))?;
        let mut child = Self { role: role.to_owned(), process, lines: BufReader::new(output).lines() };
        child.answer::<()>()?;
        Ok(child)
    }

    /// Asks, and waits for the answer.
    ///
    /// # Errors
    /// It has ended.
    pub fn ask<T: DeserializeOwned>(&mut self, question: &str) -> Result<T, Failed> {
        let input = self.process.stdin.as_mut();
        let asked = input.map(|input| writeln!(input, "{question}"));
        if !matches!(asked, Some(Ok(()))) {
            return Err(self.ended());
        }
        self.answer()
    }

    fn answer<T: DeserializeOwned>(&mut self) -> Result<T, Failed> {
        match self.lines.next() {
            Some(Ok(line)) => serde_json::from_str(&line).map_err(Failed::at(&self.role)),
            _ => Err(self.ended()),
        }
    }

    fn ended(&self) -> Failed {
        Failed(format!("the process {:?} has ended; see above", self.role))
    }
}

/// Answers, in a role, until the input ends. First of all it says that it is there.
///
/// # Errors
/// What `answer` says.
pub fn serve<T: Serialize>(mut answer: impl FnMut(&str) -> Result<T, Failed>) -> Result<(), Failed> {
    let mut output = std::io::stdout();
    if writeln!(output, "null").is_err() {
        return Ok(());
    }
    for line in std::io::stdin().lines().map_while(Result::ok) {
        let answer = serde_json::to_string(&answer(&line)?).map_err(Failed::at("an answer"))?;
        // Who has asked is gone.
        if writeln!(output, "{answer}").is_err() {
            break;
        }
    }
    Ok(())
}

/// The argument before the role.
pub const ROLE: &str = "--role";
