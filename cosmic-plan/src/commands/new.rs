//! `cosmic-plan new`

use super::support::{Failure, write};
use std::path::Path;
use std::process::ExitCode;

pub(super) fn run(file: &Path) -> Result<ExitCode, Failure> {
    if file.exists() {
        return Err(Failure::Line(format!("{} exists; give another name", file.display())));
    }
    write(file, cosmic_plan::cluster::EXAMPLE)?;
    println!("wrote {0}; now try: cosmic-plan check {0}", file.display());
    Ok(ExitCode::SUCCESS)
}
