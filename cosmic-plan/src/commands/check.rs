//! `cosmic-plan check`

use super::support::{Failure, INFEASIBLE, cluster, planned};
use std::path::Path;
use std::process::ExitCode;

pub(super) fn run(file: &Path, json: bool) -> Result<ExitCode, Failure> {
    let cluster = cluster(file, json)?;
    match planned(&cluster) {
        Ok(plan) => {
            println!("{} slots, cycle {}", plan.slots().len(), plan.cycle());
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => {
            println!("{error:?}");
            Ok(ExitCode::from(INFEASIBLE))
        }
    }
}
