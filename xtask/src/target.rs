//! How code for the Cortex-M is compiled here.
//!
//! Usually rustup has, or can get, the target's precompiled core library. Where its server cannot be
//! reached, Debian's packages `rustc-web` and `rust-web-src` carry a compiler with the source of that
//! library, which cargo then builds along.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Result, bail};

use crate::workspace::Workspace;

/// The target triple of the boards: a Cortex-M4 with its floating point unit.
pub(crate) const TRIPLE: &str = "thumbv7em-none-eabihf";

/// The environment variable that forces a way: `rustup` or `debian`.
pub(crate) const VARIABLE: &str = "COSMIC_TARGET_WAY";

/// The oldest compiler that builds this workspace, as its manifest says.
pub(crate) const OLDEST_COMPILER: &str = env!("CARGO_PKG_RUST_VERSION");

/// Where the target's core library comes from.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum TargetWay {
    /// Precompiled, from rustup.
    Rustup,
    /// Built from source, with Debian's compiler.
    Debian {
        /// The compiler.
        compiler: PathBuf,
        /// A linker of LLVM's.
        linker: PathBuf,
    },
}

/// Which ways may be tried.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Choice {
    /// Whatever is there.
    Any,
    /// rustup's only.
    Rustup,
    /// Debian's only.
    Debian,
}

impl Choice {
    /// What the environment asks for.
    pub(crate) fn from_environment() -> Result<Self> {
        Self::parse(env::var(VARIABLE).ok().as_deref())
    }

    fn parse(value: Option<&str>) -> Result<Self> {
        match value {
            None | Some("") => Ok(Self::Any),
            Some("rustup") => Ok(Self::Rustup),
            Some("debian") => Ok(Self::Debian),
            Some(other) => bail!("{VARIABLE} is `{other}`; set it to `rustup` or `debian`, or unset it"),
        }
    }

    /// Returns whether rustup's library may be used.
    pub(crate) fn allows_rustup(self) -> bool {
        self != Self::Debian
    }

    /// Returns whether Debian's compiler may be used.
    pub(crate) fn allows_debian(self) -> bool {
        self != Self::Rustup
    }
}

impl TargetWay {
    /// The way that works without installing anything.
    pub(crate) fn find(choice: Choice) -> Option<Self> {
        let rustup = || Self::rustup().filter(|_| choice.allows_rustup());
        let debian = || Self::debian().filter(|_| choice.allows_debian());
        rustup().or_else(debian)
    }

    /// rustup's way, if the target is installed for the compiler in use.
    fn rustup() -> Option<Self> {
        let sysroot = sysroot(Path::new(&active_compiler()))?;
        sysroot.join("lib/rustlib").join(TRIPLE).join("lib").is_dir().then_some(Self::Rustup)
    }

    /// Debian's way, if a compiler is there that is new enough, with its source, and a linker.
    fn debian() -> Option<Self> {
        let all_there = missing_for_debian().is_empty();
        let compiler = PathBuf::from(DEBIAN_COMPILER);
        all_there.then_some(Self::Debian { compiler, linker: linker()? })
    }

    /// A call of cargo that builds for the target; its subcommand is the first argument.
    pub(crate) fn cargo(&self, workspace: &Workspace, subcommand: &str) -> Command {
        let mut command = workspace.cargo();
        command.arg(subcommand).args(["--target", TRIPLE]);
        if let Self::Debian { compiler, linker } = self {
            // Its products must not be mixed with those of the other compiler.
            command.arg("--target-dir").arg(self.target_dir(workspace));
            command.arg("-Zbuild-std=core,alloc");
            command.env("RUSTC", compiler).env("RUSTC_BOOTSTRAP", "1");
            command.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker);
            let flags = env::var("RUSTFLAGS").unwrap_or_default();
            command.env("RUSTFLAGS", format!("{flags} -Clinker-flavor=ld.lld").trim());
        }
        command
    }

    /// Where cargo puts the products.
    pub(crate) fn target_dir(&self, workspace: &Workspace) -> PathBuf {
        match self {
            Self::Rustup => workspace.target_dir().to_owned(),
            Self::Debian { .. } => workspace.target_dir().join("debian"),
        }
    }
}

impl fmt::Display for TargetWay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rustup => f.write_str("rustup"),
            Self::Debian { compiler, .. } => write!(f, "the source of {}", compiler.display()),
        }
    }
}

/// Answers whether something is there.
type IsThere = fn() -> bool;

/// Debian's packages for its way, each with the question whether it is needed no more.
pub(crate) const DEBIAN_PACKAGES: [(&str, IsThere); 3] = [
    ("rustc-web", || {
        version(Path::new(DEBIAN_COMPILER)).is_some_and(|version| is_at_least(&version, OLDEST_COMPILER))
    }),
    ("rust-web-src", || {
        let library = "lib/rustlib/src/rust/library/core/Cargo.toml";
        sysroot(Path::new(DEBIAN_COMPILER)).is_some_and(|sysroot| sysroot.join(library).is_file())
    }),
    ("lld", || linker().is_some()),
];

/// Those of Debian's packages that are still needed.
pub(crate) fn missing_for_debian() -> Vec<&'static str> {
    let missing = DEBIAN_PACKAGES.iter().filter(|(_, is_there)| !is_there());
    missing.map(|(package, _)| *package).collect()
}

/// The compiler that cargo uses, unless told otherwise.
fn active_compiler() -> String {
    env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned())
}

fn sysroot(compiler: &Path) -> Option<PathBuf> {
    stdout(Command::new(compiler).args(["--print", "sysroot"])).map(PathBuf::from)
}

/// The version of a compiler, such as `1.96.0`.
fn version(compiler: &Path) -> Option<String> {
    let line = stdout(Command::new(compiler).arg("--version"))?;
    line.split_whitespace().nth(1).map(str::to_owned)
}

/// rustup's copy of LLVM's linker, or the one on the PATH.
fn linker() -> Option<PathBuf> {
    let bundled = || {
        let platforms = fs::read_dir(sysroot(Path::new(&active_compiler()))?.join("lib/rustlib")).ok()?;
        platforms.flatten().map(|entry| entry.path().join("bin/rust-lld")).find(|path| path.is_file())
    };
    bundled().or_else(|| find_program("ld.lld"))
}

/// A program on the PATH.
pub(crate) fn find_program(name: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|directory| directory.join(name)).find(|path| path.is_file())
}

fn stdout(command: &mut Command) -> Option<String> {
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// Returns whether the version `found` (such as `1.96.0`) is the version `oldest` (such as `1.95`) or newer.
fn is_at_least(found: &str, oldest: &str) -> bool {
    let numbers = |version: &str| -> Vec<u32> {
        // A pre-release such as 1.97.0-nightly counts as its release.
        let release = version.split(['-', '+']).next().unwrap_or_default();
        release.split('.').map(|part| part.parse().unwrap_or(0)).collect()
    };
    let (found, oldest) = (numbers(found), numbers(oldest));
    found.into_iter().chain(std::iter::repeat(0)).take(oldest.len()).ge(oldest.iter().copied())
}

/// Where Debian puts its compiler.
const DEBIAN_COMPILER: &str = "/usr/bin/rustc";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_as_numbers() {
        assert!(is_at_least("1.96.0", "1.95"));
        assert!(is_at_least("1.95.0", "1.95"));
        assert!(is_at_least("2.0.0", "1.95"));
        assert!(is_at_least("1.100.0", "1.95.1"));
        assert!(is_at_least("1.97.0-nightly", "1.95"));
        assert!(!is_at_least("1.85.0", "1.95"));
        assert!(!is_at_least("1.95.0", "1.95.1"));
        assert!(!is_at_least("unknown", "1.95"));
    }

    #[test]
    fn the_environment_names_a_way_or_nothing() {
        assert_eq!(Choice::parse(None).unwrap(), Choice::Any);
        assert_eq!(Choice::parse(Some("debian")).unwrap(), Choice::Debian);
        let rustup = Choice::parse(Some("rustup")).unwrap();
        assert!(rustup.allows_rustup() && !rustup.allows_debian());
        let error = Choice::parse(Some("nightly")).unwrap_err().to_string();
        assert!(error.contains("`nightly`") && error.contains("`rustup` or `debian`"), "{error}");
    }

    #[test]
    fn debians_compiler_is_called_with_everything_it_needs() {
        let way = TargetWay::Debian { compiler: "/usr/bin/rustc".into(), linker: "/x/rust-lld".into() };
        let workspace = Workspace::find().unwrap();
        let command = way.cargo(&workspace, "build");
        let arguments: Vec<_> = command.get_args().map(|word| word.to_string_lossy()).collect();
        assert!(arguments.iter().any(|word| word == "-Zbuild-std=core,alloc"));
        let value = |name: &str| {
            let (_, value) = command.get_envs().find(|(key, _)| *key == name)?;
            Some(value?.to_string_lossy().into_owned())
        };
        assert_eq!(value("RUSTC").as_deref(), Some("/usr/bin/rustc"));
        assert_eq!(value("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER").as_deref(), Some("/x/rust-lld"));
        assert!(value("RUSTFLAGS").is_some_and(|flags| flags.ends_with("-Clinker-flavor=ld.lld")));
        assert_ne!(way.target_dir(&workspace), TargetWay::Rustup.target_dir(&workspace));
    }
}
