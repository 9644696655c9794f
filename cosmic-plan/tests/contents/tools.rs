//! Programs of others, by which exported files are tried. `cargo xtask test tools` installs them and insists on them;
//! without it a test whose program is missing says so and ends.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Is there, or the test ends here.
pub(crate) fn find(program: &Program) -> Option<PathBuf> {
    let found = program.places().into_iter().find(|place| program.works(place));
    if found.is_none() {
        let line =
            format!("NOT TRIED: {} is not there; `cargo xtask test tools` installs it", program.name());
        // Set by `cargo xtask test tools`.
        assert!(std::env::var_os("COSMIC_TOOLS").is_none(), "{line}");
        eprintln!("{line}");
    }
    found
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Program {
    /// A compiler of C.
    C,
    /// Python, of any kind.
    Python,
    /// Python with the package cantools.
    Cantools,
    /// Wireshark's program for terminals.
    Tshark,
}

impl Program {
    fn name(self) -> &'static str {
        match self {
            Self::C => "a C compiler",
            Self::Python => "Python",
            Self::Cantools => "Python with cantools",
            Self::Tshark => "tshark",
        }
    }

    fn places(self) -> Vec<PathBuf> {
        let of_xtask = Path::new(env!("CARGO_TARGET_TMPDIR")).join("../tools/bin/python");
        match self {
            Self::C => vec!["cc".into(), "gcc".into()],
            Self::Python => vec!["python3".into(), of_xtask],
            Self::Cantools => vec![of_xtask, "python3".into()],
            Self::Tshark => vec!["tshark".into()],
        }
    }

    fn works(self, place: &Path) -> bool {
        let arguments: &[&str] = match self {
            Self::Cantools => &["-c", "import cantools, can"],
            _ => &["--version"],
        };
        Command::new(place).args(arguments).output().is_ok_and(|output| output.status.success())
    }
}

/// Runs it and gives what it prints.
pub(crate) fn run(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = String::from_utf8_lossy(&output.stderr);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{command:?}: {said}{printed}");
    printed
}
