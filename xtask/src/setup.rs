//! Finds what the tasks need, and installs what is missing where it may.
//!
//! It may install with `rustup`, and with `apt-get` as root or by a `sudo` that asks for no password.
//! Elsewhere it says what to type. When everything is there it looks at a few files only.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Context as _, Result, bail};

use crate::apt;
use crate::run::{self, step};
use crate::target::{self, Choice, TRIPLE, TargetWay};

/// A tool that is no part of the Rust toolchain.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Tool {
    /// Runs the on-target tests.
    Qemu,
    /// Builds the emulator that the tests of `cosmic-emu` compare its processor core with.
    Cmake,
    /// What cmake's build files are for.
    Make,
    /// Compiles it.
    Compiler,
    /// Reads its header files.
    Libclang,
    /// Shows frames by the dissector that `cosmic-plan export` writes.
    Tshark,
    /// Runs the modules that it writes, and cantools.
    Python,
    /// Opens the live page, driven by the tests.
    Browser,
}

/// What the tests of the emulated cluster are built with. The cluster itself needs none of it.
pub(crate) const COMPARISON: [Tool; 4] = [Tool::Cmake, Tool::Make, Tool::Compiler, Tool::Libclang];

/// All tools.
pub(crate) const EVERYTHING: [Tool; 8] = [
    Tool::Qemu,
    Tool::Cmake,
    Tool::Make,
    Tool::Compiler,
    Tool::Libclang,
    Tool::Tshark,
    Tool::Python,
    Tool::Browser,
];

/// Finds or installs the target and the tools, and says how to compile for the target.
///
/// # Errors
/// What is missing and cannot be installed here, and what to type.
pub(crate) fn prepare(tools: &[Tool]) -> Result<TargetWay> {
    let tools = install_tools(tools);
    let way = target(Choice::from_environment()?);
    match (tools, way) {
        // Whoever has to type something wants to know all of it at once.
        (Err(one), Err(other)) => bail!("{one:#}; moreover, {other:#}"),
        (tools, way) => tools.and(way),
    }
}

/// Finds or installs these tools.
///
/// # Errors
/// What is missing and cannot be installed here, and what to type.
pub(crate) fn install_tools(tools: &[Tool]) -> Result<()> {
    let missing: Vec<Tool> = tools.iter().copied().filter(|tool| !tool.is_there()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let packages: Vec<&str> = missing.iter().map(|tool| tool.package()).collect();
    let names: Vec<String> = missing.iter().map(Tool::to_string).collect();
    step(&format!("installing {}", names.join(", ")), || apt::install(&packages))?;
    match missing.iter().find(|tool| !tool.is_there()) {
        Some(tool) => {
            bail!("{tool} is not found although Debian's package `{}` is installed", tool.package())
        }
        None => Ok(()),
    }
}

/// Finds or installs the target.
fn target(choice: Choice) -> Result<TargetWay> {
    if let Some(way) = TargetWay::find(choice) {
        return Ok(way);
    }
    if choice.allows_rustup() && target::find_program("rustup").is_some() {
        let add = || run::run(Command::new("rustup").args(["target", "add", TRIPLE]));
        match step(&format!("asking rustup for {TRIPLE}"), add) {
            Ok(()) => {
                if let Some(way) = TargetWay::find(choice) {
                    return Ok(way);
                }
            }
            Err(error) if !choice.allows_debian() => return Err(error),
            Err(_) => eprintln!("rustup cannot get it; going on to Debian's packages"),
        }
    }
    if choice.allows_debian() {
        let missing = target::missing_for_debian();
        step("installing Debian's compiler", || apt::install(&missing)).with_context(|| {
            format!("the compiler lacks {TRIPLE}, which `rustup target add {TRIPLE}` gets where it can")
        })?;
    }
    match TargetWay::find(choice) {
        Some(way) => Ok(way),
        None => bail!(
            "the compiler lacks {TRIPLE}: type `rustup target add {TRIPLE}`, or let {} be unset and \
             install Debian's `{}` (at least {})",
            target::VARIABLE,
            target::DEBIAN_PACKAGES.map(|(name, _)| name).join(" "),
            target::OLDEST_COMPILER,
        ),
    }
}

impl Tool {
    fn package(self) -> &'static str {
        match self {
            Self::Qemu => "qemu-system-arm",
            Self::Cmake => "cmake",
            Self::Make => "make",
            Self::Compiler => "g++",
            Self::Libclang => "libclang-dev",
            Self::Tshark => "tshark",
            Self::Python => "python3-venv",
            // Chromium comes with it.
            Self::Browser => "chromium-driver",
        }
    }

    fn is_there(&self) -> bool {
        match self {
            Self::Qemu => target::find_program("qemu-system-arm").is_some(),
            Self::Cmake => target::find_program("cmake").is_some(),
            Self::Make => target::find_program("make").is_some(),
            Self::Compiler => target::find_program("c++").is_some(),
            Self::Tshark => target::find_program("tshark").is_some(),
            Self::Python => has_venv(),
            Self::Browser => target::find_program("chromedriver").is_some(),
            Self::Libclang => env::var_os("LIBCLANG_PATH").is_some() || has_libclang(&library_directories()),
        }
    }
}

impl fmt::Display for Tool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Qemu => "QEMU",
            Self::Cmake => "cmake",
            Self::Make => "make",
            Self::Compiler => "a C and C++ compiler",
            Self::Libclang => "libclang",
            Self::Tshark => "tshark",
            Self::Python => "Python with its module venv",
            Self::Browser => "Chromium with its driver",
        })
    }
}

/// Returns whether there is a Python that can make a place for packages of its own.
fn has_venv() -> bool {
    let output = Command::new("python3").args(["-c", "import ensurepip, venv"]).output();
    output.is_ok_and(|output| output.status.success())
}

/// Where libclang may stand: each LLVM of Debian's has a directory of its own.
fn library_directories() -> Vec<PathBuf> {
    let mut directories: Vec<PathBuf> =
        ["/usr/lib", "/usr/lib64", "/usr/local/lib"].into_iter().map(PathBuf::from).collect();
    let entries = fs::read_dir("/usr/lib").into_iter().flatten().flatten();
    directories.extend(entries.map(|entry| entry.path().join("lib")));
    directories
}

/// Returns whether libclang is in one of the directories, and beside it the headers that come with a
/// compiler.
fn has_libclang(directories: &[PathBuf]) -> bool {
    directories.iter().any(|directory| has_library(directory) && directory.join("clang").is_dir())
}

fn has_library(directory: &Path) -> bool {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries.into_iter().any(|entry| is_libclang(&entry.file_name().to_string_lossy()))
}

/// `libclang.so`, `libclang-14.so.1` and the like, but not `libclang-cpp.so`.
fn is_libclang(name: &str) -> bool {
    let Some(rest) = name.strip_prefix("libclang") else { return false };
    let version = rest.strip_prefix('-').unwrap_or(rest);
    let version = version.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
    let is_versioned = rest.starts_with(".so") || rest.starts_with('-') && version.starts_with("so");
    is_versioned || rest.starts_with(".dylib")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn libclang_is_told_from_its_relatives() {
        for name in ["libclang.so", "libclang.so.1", "libclang-14.so.1", "libclang-14.so.14.0.6"] {
            assert!(is_libclang(name), "{name}");
        }
        for name in ["libclang-cpp.so.14", "libclangAST.a", "libLLVM.so", "libclang.a"] {
            assert!(!is_libclang(name), "{name}");
        }
    }

    #[test]
    fn libclang_without_headers_does_not_count() {
        let directory = env::temp_dir().join(format!("xtask-libclang-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        fs::write(directory.join("libclang-14.so.1"), "").unwrap();
        let directories = [directory.clone()];
        assert!(!has_libclang(&directories));
        fs::create_dir(directory.join("clang")).unwrap();
        assert!(has_libclang(&directories));
        fs::remove_dir_all(directory).unwrap();
    }
}
