//! What all experiments do with their results.

use anyhow::Context as _;
use cosmic_commands::output::Pending;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;

/// Whether the promise holds that the experiment is about.
pub(crate) enum Conclusion {
    Holds,
    /// It does not, for this reason.
    Fails(String),
}

/// Where results go: a file, or standard output.
pub(crate) enum Sink {
    StandardOutput,
    File(Pending),
}

impl Sink {
    /// Opens what an option names, so that it fails before the work and not behind it: a file, or standard
    /// output if it is `-`.
    pub(crate) fn open(path: Option<&Path>, remedy: &'static str) -> anyhow::Result<Option<Self>> {
        let open = |path: &Path| {
            let is_standard_output = path == Path::new("-");
            let file = || Ok(Self::File(Pending::create(path, remedy)?));
            if is_standard_output { Ok(Self::StandardOutput) } else { file() }
        };
        path.map(open).transpose()
    }

    pub(crate) fn write(self, text: &str) -> anyhow::Result<()> {
        match self {
            Self::StandardOutput => print!("{text}"),
            Self::File(mut file) => {
                file.write_all(text.as_bytes())?;
                file.finish()?;
            }
        }
        Ok(())
    }
}

/// Where an experiment shows its results: as text, unless standard output is for JSON.
pub(crate) struct Results {
    json: Option<Sink>,
}

impl Results {
    /// To be called before the work.
    pub(crate) fn open(json: Option<&Path>) -> anyhow::Result<Self> {
        Ok(Self { json: Sink::open(json, "name another file with --json")? })
    }

    pub(crate) fn show(self, report: &(impl Serialize + Display)) -> anyhow::Result<()> {
        if !matches!(self.json, Some(Sink::StandardOutput)) {
            print!("{report}");
        }
        let Some(json) = self.json else { return Ok(()) };
        let text = serde_json::to_string_pretty(report).context("the results cannot be written as JSON")?;
        json.write(&(text + "\n"))
    }
}

/// A bar on a terminal, nothing elsewhere.
pub(crate) fn progress(steps: u64, unit: &str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left");
    let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}
