//! `cosmic-plan check` and `cosmic-plan report`

use super::support::{Failure, planned, print_json, print_text, with_progress};
use cosmic_plan::analysis::sensitivity::{common_growth, growth};
use cosmic_plan::output::{report as machine, text};
use cosmic_plan::plan::Effort;
use std::path::Path;
use std::process::ExitCode;

pub(super) fn check(file: &Path, json: bool) -> Result<ExitCode, Failure> {
    let planned = planned(file, json)?;
    if json {
        let mut value = machine::of_plan(&planned.cluster, &planned.plan, &planned.assessment);
        value["advice"] = machine::of_advice(&planned.advice());
        print_json(&value);
    } else {
        print_text(&format!("{}\n", text::summary(&planned.cluster, &planned.plan, &planned.assessment)));
        planned.print_advice();
    }
    Ok(planned.exit_code())
}

pub(super) fn report(file: &Path, json: bool) -> Result<ExitCode, Failure> {
    let planned = planned(file, json)?;
    let cluster = &planned.cluster;
    // With many channels the many trials would take minutes.
    let few = cluster.channels.len() <= MOST_CHANNELS;
    let (each, common) = with_progress(|watch| {
        let effort = Effort::watched(watch);
        let common = common_growth(cluster, &effort);
        (if few { growth(cluster, &effort) } else { Vec::new() }, common)
    });
    if json {
        let mut value = machine::of_plan(cluster, &planned.plan, &planned.assessment);
        value["growth"] = machine::of_growth(cluster, &each, common);
        print_json(&value);
    } else {
        print_text(&text::of_plan(cluster, &planned.plan, &planned.assessment));
        planned.print_advice();
        print_text(&text::of_growth(cluster, &each, common));
    }
    Ok(planned.exit_code())
}

/// Up to so many channels the report says how far each could grow.
const MOST_CHANNELS: usize = 60;
