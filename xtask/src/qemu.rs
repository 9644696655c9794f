//! Runs the on-target tests in QEMU; `qemu-tests/README.md` says what its options mean.

use std::fs;
use std::io::{self, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};

use crate::images::{self, Images};
use crate::run::step;
use crate::tally::Tally;
use crate::target::TargetWay;
use crate::workspace::Workspace;

/// Builds and runs all tests of `qemu-tests`.
pub(crate) fn test(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let directory = workspace.root().join(PACKAGE);
    let built = step("building the QEMU tests", || {
        images::build(way.cargo(workspace, "build"), PACKAGE, images::PROFILE, &[])
    })?;
    step("running the QEMU tests", || {
        let mut tally = Tally::default();
        for (name, image) in &built.images {
            let expected = directory.join("expected").join(name).with_extension("out");
            match run_and_compare(image, &expected) {
                Ok(()) => {
                    println!("qemu {name} ... ok");
                    tally.passed += 1;
                }
                Err(error) => {
                    println!("qemu {name} ... FAILED: {error:#}");
                    tally.failed += 1;
                }
            }
        }
        for name in without_program(&directory.join("expected"), &built.images)? {
            println!("qemu {name} ... FAILED: expected/{name}.out has no program in src/bin/");
            tally.failed += 1;
        }
        Ok(tally)
    })
}

/// Expectations that no program is compared with: their test has vanished.
fn without_program(expected: &Path, images: &Images) -> Result<Vec<String>> {
    let entries = fs::read_dir(expected).with_context(|| format!("{} cannot be read", expected.display()))?;
    let paths = entries.flatten().map(|entry| entry.path());
    let names = paths.filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    Ok(names.filter(|name| !images.contains_key(name)).collect())
}

fn run_and_compare(image: &Path, expected: &Path) -> Result<()> {
    let expected_text = fs::read(expected).with_context(|| {
        format!("{} cannot be read; it holds what the test is to print", expected.display())
    })?;
    let (status, printed, _) = emulate(image, Stdio::inherit())?;
    if let Some(difference) = difference(&expected_text, &printed) {
        bail!("its output is not {}: {difference} ({status})", expected.display());
    }
    if !status.success() {
        bail!("it printed what it should, but ended with {status}");
    }
    Ok(())
}

/// Runs a program that measures, and returns what it prints to standard error.
pub(crate) fn measure(image: &Path) -> Result<String> {
    let (status, _, measured) = emulate(image, Stdio::piped())?;
    let measured = String::from_utf8_lossy(&measured).into_owned();
    if !status.success() {
        bail!("{} ended with {status}: {measured}", image.display());
    }
    Ok(measured)
}

/// Runs an image until it ends. Returns what it printed to standard output, and to standard error if that
/// goes to a pipe.
fn emulate(image: &Path, stderr: Stdio) -> Result<(ExitStatus, Vec<u8>, Vec<u8>)> {
    let mut child = Command::new("qemu-system-arm")
        .args(OPTIONS)
        .arg("-kernel")
        .arg(image)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(stderr)
        .spawn()
        .context("qemu-system-arm cannot be started; `cargo xtask setup` installs it")?;
    let printed = read_all(child.stdout.take());
    let measured = read_all(child.stderr.take());
    let status = wait(&mut child, PATIENCE)?;
    match (printed.join(), measured.join()) {
        (Ok(printed), Ok(measured)) => Ok((status, printed?, measured?)),
        _ => bail!("reading QEMU's output failed"),
    }
}

/// Reads a pipe, if there is one, while the program runs: a full pipe would stop it.
fn read_all(pipe: Option<impl Read + Send + 'static>) -> JoinHandle<io::Result<Vec<u8>>> {
    thread::spawn(move || {
        let mut read = Vec::new();
        if let Some(mut pipe) = pipe {
            pipe.read_to_end(&mut read)?;
        }
        Ok(read)
    })
}

/// Waits for the end, but not for ever: a test that hangs is a failure, not a CI job without end.
fn wait(child: &mut Child, patience: Duration) -> Result<ExitStatus> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if start.elapsed() > patience {
            child.kill()?;
            child.wait()?;
            bail!("it had not ended after {} s", patience.as_secs());
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// The first line that differs, if one does.
fn difference(expected: &[u8], printed: &[u8]) -> Option<String> {
    if expected == printed {
        return None;
    }
    let mut expected_lines = expected.split(|&byte| byte == b'\n');
    let mut printed_lines = printed.split(|&byte| byte == b'\n');
    let mut number = 1;
    loop {
        let (wanted, got) = (expected_lines.next(), printed_lines.next());
        if wanted != got || wanted.is_none() {
            let show = |line: Option<&[u8]>| match line {
                Some(line) => format!("`{}`", String::from_utf8_lossy(line)),
                None => "nothing".to_owned(),
            };
            return Some(format!("line {number} is {} instead of {}", show(got), show(wanted)));
        }
        number += 1;
    }
}

pub(crate) const PACKAGE: &str = "qemu-tests";

/// How long a test may take of the host's time; each needs a fraction of a second.
const PATIENCE: Duration = Duration::from_secs(60);

const OPTIONS: [&str; 11] = [
    "-machine",
    "mps2-an386",
    "-nographic",
    "-monitor",
    "none",
    "-serial",
    "none",
    "-semihosting-config",
    "enable=on,target=native",
    "-icount",
    "shift=3,sleep=off,rr=record,rrfile=/dev/null",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_difference_is_shown() {
        assert_eq!(difference(b"a\nb\n", b"a\nb\n"), None);
        assert_eq!(difference(b"a\nb\n", b"a\nc\n").unwrap(), "line 2 is `c` instead of `b`");
        assert_eq!(difference(b"a\n", b"a\nb\n").unwrap(), "line 2 is `b` instead of ``");
        assert_eq!(difference(b"a\nb", b"a").unwrap(), "line 2 is nothing instead of `b`");
    }

    #[test]
    fn a_program_that_hangs_is_ended() {
        let mut child = Command::new("sleep").arg("600").spawn().unwrap();
        let error = wait(&mut child, Duration::ZERO).unwrap_err().to_string();
        assert_eq!(error, "it had not ended after 0 s");
        assert!(child.try_wait().unwrap().is_some());
    }

    #[test]
    fn an_expectation_without_a_test_is_found() {
        let directory = std::env::temp_dir().join(format!("xtask-expected-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        for name in ["there.out", "gone.out"] {
            fs::write(directory.join(name), "").unwrap();
        }
        let images = Images::from([("there".to_owned(), "there".into())]);
        assert_eq!(without_program(&directory, &images).unwrap(), ["gone"]);
        fs::remove_dir_all(directory).unwrap();
    }

    #[test]
    fn the_options_are_those_of_the_readme() {
        let readme = include_str!("../../qemu-tests/README.md").replace("\\\n", " ");
        let words: Vec<&str> = readme.split_whitespace().collect();
        assert!(words.windows(OPTIONS.len()).any(|window| window == OPTIONS));
    }
}
