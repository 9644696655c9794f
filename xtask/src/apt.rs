//! Installs Debian packages, where it may.

use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use anyhow::{Result, bail};

use crate::run;
use crate::target;

/// Installs Debian packages, or says what to type.
pub(crate) fn install(packages: &[&str]) -> Result<()> {
    let installer = Installer::find();
    if let Some(advice) = advice(installer, packages) {
        bail!(advice);
    }
    let mut words = vec!["install", "--yes", "--no-install-recommends"];
    words.extend_from_slice(packages);
    // The lists of a fresh machine are empty, and those of an old one name files that are gone.
    let listed = packages.iter().all(|package| is_listed(package));
    if listed && patiently(&mut installer.apt_get(&words), thread::sleep).is_ok() {
        return Ok(());
    }
    patiently(&mut installer.apt_get(&["update"]), thread::sleep)?;
    patiently(&mut installer.apt_get(&words), thread::sleep)
}

/// Runs `apt-get`, again and again while another process holds one of its locks.
///
/// apt itself waits for the lock of dpkg ([`Installer::apt_get`] says how long), but not in all versions for
/// those of the package lists and of its archive.
fn patiently(command: &mut Command, mut pause: impl FnMut(Duration)) -> Result<()> {
    let mut waited = Duration::ZERO;
    loop {
        let (status, complaints) = run::with_complaints(command)?;
        if status.success() {
            return Ok(());
        }
        let line = run::line(command);
        if !is_locked_out(&complaints) {
            bail!("`{line}` failed ({status}); see above");
        }
        if waited >= PATIENCE {
            bail!("`{line}`: another process has held a lock of apt for {} s; end it", waited.as_secs());
        }
        eprintln!("waiting for another process to finish with apt ({} s so far)", waited.as_secs());
        pause(BETWEEN_TRIES);
        waited += BETWEEN_TRIES;
    }
}

/// Returns whether these complaints of `apt-get` say that another process holds a lock.
fn is_locked_out(complaints: &str) -> bool {
    // apt-pkg/aptconfiguration and debsystem: "Could not get lock FILE", then what it was for.
    ["Could not get lock", "is another process using it"].iter().any(|words| complaints.contains(words))
}

/// What to type where nothing may be installed.
fn advice(installer: Installer, packages: &[&str]) -> Option<String> {
    let packages = packages.join(" ");
    match installer {
        Installer::Root | Installer::Sudo => None,
        Installer::Nobody => Some(format!(
            "only root may install packages; type this, then call again: \
             sudo apt-get update && sudo apt-get install --no-install-recommends {packages}"
        )),
        Installer::NoApt => Some(format!(
            "there is no apt-get here; install what Debian calls `{packages}` in this system's own way"
        )),
    }
}

/// Returns whether the package lists know it.
fn is_listed(package: &str) -> bool {
    let shown = Command::new("apt-cache").args(["show", package]).stderr(Stdio::null()).output();
    shown.is_ok_and(|output| output.status.success() && !output.stdout.is_empty())
}

/// How packages can be installed here.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Installer {
    /// As root.
    Root,
    /// By `sudo`, which asks for no password.
    Sudo,
    /// Only by the user.
    Nobody,
    /// This is no Debian.
    NoApt,
}

impl Installer {
    fn find() -> Self {
        if target::find_program("apt-get").is_none() {
            return Self::NoApt;
        }
        let id = Command::new("id").arg("-u").output();
        if id.is_ok_and(|output| output.stdout.trim_ascii() == b"0") {
            return Self::Root;
        }
        let sudo = Command::new("sudo")
            .args(["--non-interactive", "true"])
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if sudo.is_ok_and(|status| status.success()) { Self::Sudo } else { Self::Nobody }
    }

    /// A call of `apt-get` that asks nothing and speaks English, so that [`is_locked_out`] understands it.
    fn apt_get(self, arguments: &[&str]) -> Command {
        let mut command = match self {
            Self::Sudo => {
                let mut command = Command::new("sudo");
                command
                    .arg("--non-interactive")
                    .args(ENVIRONMENT.map(|(name, value)| format!("{name}={value}")));
                command.arg("apt-get");
                command
            }
            _ => Command::new("apt-get"),
        };
        command.envs(ENVIRONMENT);
        command.arg("--option").arg(format!("DPkg::Lock::Timeout={}", PATIENCE.as_secs()));
        command.args(arguments);
        command
    }
}

/// How long another process may use apt: a large upgrade takes minutes.
const PATIENCE: Duration = Duration::from_secs(600);
const BETWEEN_TRIES: Duration = Duration::from_secs(3);
const ENVIRONMENT: [(&str, &str); 2] = [("DEBIAN_FRONTEND", "noninteractive"), ("LC_ALL", "C")];

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::Path;

    #[test]
    fn who_may_not_install_is_told_what_to_type() {
        assert_eq!(advice(Installer::Root, &["cmake"]), None);
        assert_eq!(advice(Installer::Sudo, &["cmake"]), None);
        let line = advice(Installer::Nobody, &["cmake", "make"]).unwrap();
        assert!(line.ends_with("sudo apt-get install --no-install-recommends cmake make"), "{line}");
        assert!(!line.contains('\n'));
        assert!(advice(Installer::NoApt, &["cmake"]).unwrap().contains("`cmake`"));
    }

    #[test]
    fn sudo_never_asks_for_a_password_and_apt_waits_for_dpkg() {
        let wait = "apt-get --option DPkg::Lock::Timeout=600 update";
        let sudo = format!("sudo --non-interactive DEBIAN_FRONTEND=noninteractive LC_ALL=C {wait}");
        assert_eq!(run::line(&Installer::Sudo.apt_get(&["update"])), sudo);
        assert_eq!(run::line(&Installer::Root.apt_get(&["update"])), wait);
    }

    /// An `apt-get` that complains as long as there is a lock.
    fn pretender(lock: &Path) -> Command {
        let mut command = Command::new("sh");
        let complaint = "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 1 (apt-get)";
        command.args(["-c", "if [ -e \"$1\" ]; then echo \"$2\" >&2; exit 100; fi", "apt-get"]);
        command.arg(lock).arg(complaint);
        command
    }

    #[test]
    fn a_held_lock_is_waited_for() {
        let lock = std::env::temp_dir().join(format!("xtask-apt-lock-{}", std::process::id()));
        fs::write(&lock, "").unwrap();
        let mut pauses = Vec::new();
        let pause = |pause| {
            pauses.push(pause);
            if pauses.len() == 3 {
                fs::remove_file(&lock).unwrap();
            }
        };
        patiently(&mut pretender(&lock), pause).unwrap();
        assert_eq!(pauses, [BETWEEN_TRIES; 3]);
    }

    #[test]
    fn patience_ends() {
        let mut waited = Duration::ZERO;
        let error = patiently(&mut pretender(Path::new("/")), |pause| waited += pause).unwrap_err();
        assert!(error.to_string().ends_with("has held a lock of apt for 600 s; end it"), "{error}");
        assert_eq!(waited, PATIENCE);
    }

    #[test]
    fn other_failures_are_not_waited_for() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo 'E: Unable to locate package cmake' >&2; exit 100"]);
        let error = patiently(&mut command, |_| panic!("it waits")).unwrap_err().to_string();
        assert!(error.contains("failed (exit status: 100)"), "{error}");
    }
}
