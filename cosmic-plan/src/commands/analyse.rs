//! `cosmic-plan analyse`

use super::support::{Failure, INFEASIBLE, print_json, print_text, source, with_progress};
use cosmic_plan::analysis::set::{Findings, MessageSet};
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;

pub(super) fn run(file: &Path, json: bool) -> Result<ExitCode, Failure> {
    let set = MessageSet::read(&source(file)?)
        .map_err(|problems| Failure::Document { problems: Box::new(problems), json })?;
    let findings = with_progress(|watch| set.analyse(watch));
    if json {
        print_json(&serde_json::json!(findings));
    } else {
        print_text(&table(&findings));
    }
    Ok(if findings.verdict == "holds" { ExitCode::SUCCESS } else { ExitCode::from(INFEASIBLE) })
}

fn table(findings: &Findings) -> String {
    let mut out = String::from("in µs\n");
    // Writing into a string does not fail.
    let _ = writeln!(
        out,
        "{:<16} {:>9} {:>9} {:>9} {:>8} {:>10} {:>10}  verdict",
        "message", "period", "deadline", "blocking", "jitter", "exact", "sufficient"
    );
    let or_dash = |value: Option<f64>| value.map_or("-".to_owned(), |value| value.to_string());
    for finding in &findings.messages {
        let name: String = finding.name.chars().take(16).collect();
        let _ = writeln!(
            out,
            "{name:<16} {:>9} {:>9} {:>9} {:>8} {:>10} {:>10}  {}",
            finding.period_us,
            finding.deadline_us,
            finding.blocking_us,
            finding.jitter_us,
            or_dash(finding.exact_us),
            or_dash(finding.sufficient_us),
            finding.verdict
        );
    }
    let _ = writeln!(out, "utilisation {:.2} %: the set {}", findings.utilisation * 100.0, findings.verdict);
    out
}
