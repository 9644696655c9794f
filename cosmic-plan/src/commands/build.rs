//! `cosmic-plan new`, `cosmic-plan build` and `cosmic-plan render`

use super::export;
use super::support::{Failure, planned, print_json, write};
use cosmic_plan::output::{report, rust, svg, text};
use std::path::Path;
use std::process::ExitCode;

pub(super) fn new(file: &Path) -> Result<ExitCode, Failure> {
    if file.exists() {
        return Err(Failure::Line(format!("{} exists; give another name", file.display())));
    }
    write(file, cosmic_plan::cluster::EXAMPLE.as_bytes())?;
    println!("wrote {0}; now try: cosmic-plan check {0}", file.display());
    Ok(ExitCode::SUCCESS)
}

pub(super) fn build(file: &Path, out: &Path, json: bool) -> Result<ExitCode, Failure> {
    let planned = planned(file, json)?;
    let (cluster, plan, assessment) = (&planned.cluster, &planned.plan, &planned.assessment);
    let name = export::source_name(file);
    let calendar =
        rust::render(cluster, plan, &name, &[]).map_err(|error| Failure::Line(error.to_string()))?;
    let machine = report::of_plan(cluster, plan, assessment);
    let files = [
        ("calendar.rs", calendar),
        ("report.json", format!("{machine:#}\n")),
        ("report.txt", text::of_plan(cluster, plan, assessment)),
        ("timeline.svg", svg::render(cluster, plan, assessment)),
    ];
    std::fs::create_dir_all(out).map_err(|error| {
        Failure::Line(format!("{} cannot be made: {error}; choose another --out", out.display()))
    })?;
    for (name, text) in &files {
        write(&out.join(name), text.as_bytes())?;
    }
    let mut paths: Vec<_> = files.iter().map(|(name, _)| out.join(name)).collect();
    paths.extend(export::all(&planned, &name, out)?);
    if json {
        let mut value = machine;
        value["files"] = paths.iter().map(|path| path.display().to_string()).collect();
        print_json(&value);
    } else {
        println!("{}", text::summary(cluster, plan, assessment));
        for path in &paths {
            println!("  wrote {}", path.display());
        }
    }
    Ok(planned.exit_code())
}

pub(super) fn render(file: &Path, out: &Path) -> Result<ExitCode, Failure> {
    let planned = planned(file, false)?;
    write(out, svg::render(&planned.cluster, &planned.plan, &planned.assessment).as_bytes())?;
    println!("wrote {}", out.display());
    Ok(ExitCode::SUCCESS)
}
