//! What all experiments do with their results.

use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::path::Path;

/// Does the promise hold that the experiment is about?
pub(crate) enum Verdict {
    Holds,
    /// It does not, for this reason.
    Fails(String),
}

/// Writes the results to a file, or to standard output if it is `-`.
pub(crate) fn write_json(path: &Path, results: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(results).context("the results cannot be written as JSON")?;
    write(path, &(text + "\n"))
}

/// Writes a text file, or to standard output if it is `-`.
pub(crate) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    if path == Path::new("-") {
        print!("{text}");
        return Ok(());
    }
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

/// A bar on a terminal, nothing elsewhere.
pub(crate) fn progress(steps: u64, unit: &str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left");
    let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}
