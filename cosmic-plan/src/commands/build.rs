//! `cosmic-plan build`

use super::support::{Failure, INFEASIBLE, cluster, planned, write};
use std::path::Path;
use std::process::ExitCode;

pub(super) fn run(file: &Path, out: &Path, json: bool) -> Result<ExitCode, Failure> {
    let cluster = cluster(file, json)?;
    let plan = match planned(&cluster) {
        Ok(plan) => plan,
        Err(error) => {
            println!("{error:?}");
            return Ok(ExitCode::from(INFEASIBLE));
        }
    };
    std::fs::create_dir_all(out).map_err(|error| {
        Failure::Line(format!("{} cannot be made: {error}; choose another --out", out.display()))
    })?;
    let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let rust = cosmic_plan::output::rust::render(&cluster, &plan, &name)
        .map_err(|error| Failure::Line(format!("the calendar is wrong ({error:?}); please report this")))?;
    write(&out.join("calendar.rs"), &rust)?;
    Ok(ExitCode::SUCCESS)
}
