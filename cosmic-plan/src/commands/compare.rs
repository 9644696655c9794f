//! `cosmic-plan explain` and `cosmic-plan diff`

use super::support::{Failure, planned, print_json, print_text};
use cosmic_plan::document::nearest;
use cosmic_plan::output::explain as output;
use std::path::Path;
use std::process::ExitCode;

pub(super) fn explain(file: &Path, name: &str, json: bool) -> Result<ExitCode, Failure> {
    let planned = planned(file, json)?;
    let (cluster, plan, assessment) = (&planned.cluster, &planned.plan, &planned.assessment);
    let Some(channel) = cluster.channel_named(name) else {
        let names = cluster.channels.iter().map(|channel| channel.name.as_str());
        let help = match nearest(name, names.clone()) {
            Some(nearest) => format!("did you mean {nearest}?"),
            None => format!("there are {}", names.collect::<Vec<_>>().join(", ")),
        };
        return Err(Failure::Line(format!("there is no channel {name}; {help}")));
    };
    if json {
        print_json(&output::channel_json(cluster, plan, assessment, channel));
    } else {
        print_text(&output::channel(cluster, plan, assessment, channel));
    }
    Ok(planned.exit_code())
}

pub(super) fn diff(before: &Path, after: &Path, json: bool) -> Result<ExitCode, Failure> {
    let (a, b) = (planned(before, json)?, planned(after, json)?);
    let changes =
        output::difference((&a.cluster, &a.plan, &a.assessment), (&b.cluster, &b.plan, &b.assessment));
    if json {
        print_json(&output::changes_as_json(&changes));
    } else {
        print_text(&output::changes_as_text(&changes));
    }
    Ok(b.exit_code())
}
