//! What the commands share: reading, progress, failing.

use cosmic_plan::analysis::advice::advice;
use cosmic_plan::analysis::segment::{Assessment, assess};
use cosmic_plan::cluster::Cluster;
use cosmic_plan::document::file::read_text;
use cosmic_plan::document::{Problems, Source};
use cosmic_plan::output::{report, text};
use cosmic_plan::plan::relax::{Relaxation, relaxations, relaxations_of_the_largest};
use cosmic_plan::plan::{Effort, NoPlan, Plan, plan};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::RefCell;
use std::io::{IsTerminal, Write as _};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Exit code: something does not hold.
pub(super) const INFEASIBLE: u8 = 1;
/// Exit code: the input is wrong.
pub(super) const BAD_INPUT: u8 = 2;

/// Why a command ended early.
#[derive(Debug)]
pub(super) enum Failure {
    /// A document has problems.
    Document { problems: Box<Problems>, json: bool },
    /// A file cannot be read or written, or the like: one line with the remedy.
    Line(String),
    /// There is no calendar: what is to be said of it yet, for people or for machines.
    NoPlan(String),
}

impl Failure {
    pub(super) fn report(self) -> ExitCode {
        match self {
            Self::Document { problems, json: true } => {
                print_json(&serde_json::json!({ "verdict": "bad input", "problems": problems.to_json() }));
            }
            Self::Document { problems, json: false } => {
                eprint!("{}", problems.render(std::io::stderr().is_terminal()));
                let count = problems.list().len();
                eprintln!("{count} problem{}; nothing was done", if count == 1 { "" } else { "s" });
            }
            Self::Line(line) => eprintln!("cosmic-plan: {line}"),
            Self::NoPlan(text) => {
                print_text(&text);
                return ExitCode::from(INFEASIBLE);
            }
        }
        ExitCode::from(BAD_INPUT)
    }
}

/// Reads a document.
pub(super) fn source(file: &Path) -> Result<Source, Failure> {
    let text = read_text(file).map_err(|error| {
        Failure::Line(format!("{} cannot be read: {error}; give the path of a cluster file", file.display()))
    })?;
    Ok(Source::new(file.display().to_string(), text))
}

/// Reads a cluster.
pub(super) fn cluster(file: &Path, json: bool) -> Result<Cluster, Failure> {
    Cluster::read(&source(file)?).map_err(|problems| Failure::Document { problems: Box::new(problems), json })
}

/// A cluster, its plan and what is proven of it.
#[derive(Debug)]
pub(super) struct Planned {
    pub(super) cluster: Cluster,
    pub(super) plan: Plan,
    pub(super) assessment: Assessment,
}

impl Planned {
    /// What would help if not all holds.
    pub(super) fn advice(&self) -> Vec<Relaxation> {
        if self.assessment.holds() {
            return Vec::new();
        }
        with_progress(|watch| advice(&self.cluster, &self.assessment, &Effort::watched(watch)))
    }

    /// Prints what would help if not all holds.
    pub(super) fn print_advice(&self) {
        if !self.assessment.holds() {
            print_text(&text::advice(&self.advice()));
        }
    }

    /// The exit code that says whether all holds.
    pub(super) fn exit_code(&self) -> ExitCode {
        if self.assessment.holds() { ExitCode::SUCCESS } else { ExitCode::from(INFEASIBLE) }
    }
}

/// Reads, plans and analyses, with a progress bar that shows itself after a second.
pub(super) fn planned(file: &Path, json: bool) -> Result<Planned, Failure> {
    let cluster = cluster(file, json)?;
    let outcome = with_progress(|watch| {
        let effort = Effort::watched(watch);
        plan(&cluster, &effort).map_err(|failure| no_plan(&cluster, &failure, &effort, json))
    });
    let plan = outcome?;
    if let Err(faults) = cosmic_plan::verify::verify(&cluster, &plan) {
        let faults = faults.join("; ");
        return Err(Failure::Line(format!(
            "the independent check refuses the plan: {faults}; please report this"
        )));
    }
    let assessment = with_progress(|watch| {
        watch("analysing");
        assess(&cluster, &plan)
    });
    Ok(Planned { cluster, plan, assessment })
}

/// The verdict first: what helps is sought as long as steps are left.
fn no_plan(cluster: &Cluster, failure: &NoPlan, effort: &Effort<'_>, json: bool) -> Failure {
    if !json {
        print_text(&text::of_failure(cluster, failure));
    }
    let ways_out = match failure {
        NoPlan::Impossible(conflict) => relaxations(cluster, conflict, effort),
        NoPlan::GaveUp { .. } => relaxations_of_the_largest(cluster, effort),
    };
    Failure::NoPlan(if json {
        format!("{:#}\n", report::of_failure(cluster, failure, &ways_out))
    } else {
        text::ways_out(&ways_out)
    })
}

/// Runs something long with a progress bar that shows itself after a second.
pub(super) fn with_progress<T>(run: impl FnOnce(&dyn Fn(&str)) -> T) -> T {
    let started = Instant::now();
    let bar: RefCell<Option<ProgressBar>> = RefCell::new(None);
    let watch = |what: &str| {
        if started.elapsed() < Duration::from_secs(1) {
            return;
        }
        let mut bar = bar.borrow_mut();
        let bar = bar.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{spinner} {msg} ({elapsed})");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.enable_steady_tick(Duration::from_millis(120));
            bar
        });
        bar.set_message(what.to_owned());
    };
    let result = run(&watch);
    if let Some(bar) = bar.borrow_mut().take() {
        bar.finish_and_clear();
    }
    result
}

/// Writes a file, whole or not at all.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let whole = || {
        let partial = path.with_extension("partial");
        std::fs::write(&partial, bytes)?;
        std::fs::rename(&partial, path)
    };
    whole().map_err(|error: std::io::Error| {
        Failure::Line(format!("{} cannot be written: {error}; choose another place", path.display()))
    })
}

/// Prints JSON. A reader that closed the pipe does not want the rest.
pub(super) fn print_json(value: &serde_json::Value) {
    print_text(&format!("{value:#}\n"));
}

/// Prints text, as [`print_json`] does.
pub(super) fn print_text(text: &str) {
    let mut out = std::io::stdout();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}
