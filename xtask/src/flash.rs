//! Flashes an image onto a board, and shows the log of one that runs there, by probe-rs.
//!
//! What is flashed is what the last `cargo xtask build` made for the cluster: nothing is built here. Each thing that
//! can be wrong has a line of its own and an exit code of its own ([`Trouble`]). probe-rs tells most of them only in
//! its text, which is read for that; whatever is not recognised there is shown as it is.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context as _, Result};
use clap::Args;

use crate::board::{self, Board};
use crate::plan;
use crate::run;
use crate::target::find_program;
use crate::workspace::Workspace;

/// What to flash, and onto what.
#[derive(Args)]
pub(crate) struct Options {
    /// The board.
    #[arg(long, value_enum)]
    board: Board,
    /// The application, by the name of its image. It is the node: its plan is built in.
    #[arg(long)]
    app: String,
    /// Of this cluster instead of the example.
    #[arg(long, value_name = "FILE")]
    cluster: Option<PathBuf>,
    /// The debug probe, as `probe-rs list` names it (VID:PID or VID:PID:serial), where there are several.
    #[arg(long)]
    probe: Option<String>,
    /// Print the commands, and do nothing.
    #[arg(long)]
    dry_run: bool,
}

/// What is to be done with the image.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Act {
    /// Write it, and start it.
    Flash,
    /// Show its log; it has been flashed.
    Attach,
}

impl Act {
    /// The calls of probe-rs, each as its arguments; before them [`asks_for_chip`].
    fn calls(self, options: &Options, image: &Path) -> Vec<Vec<String>> {
        let image = image.display().to_string();
        match self {
            Self::Flash => {
                vec![call(options, "download", &["--verify", &image]), call(options, "reset", &[])]
            }
            Self::Attach => vec![call(options, "attach", &[&image])],
        }
    }
}

/// A call of probe-rs that is about the chip of the board.
fn call(options: &Options, verb: &str, more: &[&str]) -> Vec<String> {
    let mut words = vec![verb.to_owned(), "--chip".to_owned(), options.board.chip().to_owned()];
    words.extend(options.probe.iter().flat_map(|probe| ["--probe".to_owned(), probe.clone()]));
    words.extend(more.iter().map(|&word| word.to_owned()));
    words
}

/// Reads which chip it is (RM0090, `DBGMCU_IDCODE`): probe-rs believes `--chip`, and would write into another one.
fn asks_for_chip(options: &Options) -> Vec<String> {
    call(options, "read", &["b32", "0xE0042000", "1"])
}

/// The device identifier in what that prints: a word of eight hexadecimal digits, behind its address or alone.
fn device(printed: &str) -> Option<u32> {
    let word = printed.split_whitespace().rfind(|word| word.len() == 8)?;
    Some(u32::from_str_radix(word, 16).ok()? & 0xFFF)
}

/// Why it cannot be done.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Trouble {
    NoImage { app: String, plan: String, there: Vec<String>, build: String },
    NoProbeRs,
    NoProbe,
    SeveralProbes(Vec<String>),
    WrongChip(&'static str),
    OtherChip { wanted: &'static str, device: u32 },
    Locked,
    Failed(String),
}

impl Trouble {
    /// The exit code. 1 and 2 are errors of xtask itself and of its arguments.
    const fn code(&self) -> u8 {
        match self {
            Self::NoImage { .. } => 10,
            Self::NoProbeRs => 11,
            Self::NoProbe => 12,
            Self::SeveralProbes(_) => 13,
            Self::WrongChip(_) | Self::OtherChip { .. } => 14,
            Self::Locked => 15,
            Self::Failed(_) => 16,
        }
    }

    /// What a call of probe-rs complained of.
    fn of_complaints(complaints: &str, chip: &'static str) -> Self {
        let text = complaints.to_lowercase();
        let says = |words: &[&str]| words.iter().any(|word| text.contains(word));
        // As the versions from 0.20 on put it, and before.
        if says(&[
            "no connected probes were found",
            "no debug probes were found",
            "no probe was found",
            "probe was not found",
        ]) {
            Self::NoProbe
        } else if says(&["probes were found", "multiple probes", "more than one probe"]) {
            Self::SeveralProbes(Vec::new())
        } else if says(&[
            "locked",
            "readout protection",
            "read protection",
            "lacked the permission",
            "protected",
        ]) {
            Self::Locked
        } else if says(&["does not match", "unexpected chip", "unknown chip", "wrong chip", "idcode"]) {
            Self::WrongChip(chip)
        } else {
            let last = complaints.lines().rfind(|line| !line.trim().is_empty());
            Self::Failed(last.unwrap_or("it said nothing").trim().to_owned())
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoImage { app, plan, there, build } if there.is_empty() => {
                write!(f, "there is no image `{app}` for {plan}; `{build}` makes it")
            }
            Self::NoImage { app, plan, there, .. } => {
                write!(f, "there is no image `{app}` for {plan}; there are {}", there.join(", "))
            }
            Self::NoProbeRs => {
                f.write_str("probe-rs is not installed; `cargo install probe-rs-tools --locked` does it")
            }
            Self::NoProbe => {
                f.write_str("no debug probe was found; is it plugged in, and may you use it (udev rules)?")
            }
            Self::SeveralProbes(probes) if probes.is_empty() => {
                f.write_str("there are several debug probes; name one by --probe VID:PID:SERIAL")
            }
            Self::SeveralProbes(probes) => {
                write!(f, "there are several debug probes; name one by --probe: {}", probes.join("; "))
            }
            Self::WrongChip(chip) => write!(f, "the chip on the board is no {chip}; is --board right?"),
            Self::OtherChip { wanted, device } => {
                write!(
                    f,
                    "the chip on the board is no {wanted} (its device id is {device:#x}); is --board right?"
                )
            }
            Self::Locked => f.write_str(
                "the chip is locked (read-out protection); unlock it first, which erases it, for example by \
                 STM32CubeProgrammer",
            ),
            Self::Failed(said) => write!(f, "probe-rs failed: {said}"),
        }
    }
}

/// Flashes, or attaches.
pub(crate) fn task(workspace: &Workspace, options: &Options, act: Act) -> Result<ExitCode> {
    let cluster = plan::find(options.cluster.clone().unwrap_or_else(|| plan::example(workspace)))?;
    let folder = board::folder(workspace, &cluster, Some(options.board));
    match perform(options, act, &cluster, &folder)? {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(trouble) => {
            eprintln!("error: {trouble}");
            Ok(ExitCode::from(trouble.code()))
        }
    }
}

fn perform(options: &Options, act: Act, cluster: &Path, folder: &Path) -> Result<Result<(), Trouble>> {
    let image = folder.join(&options.app);
    // A name, not a path out of the folder.
    let is_name = Path::new(&options.app).components().count() == 1;
    if !is_name || !image.is_file() {
        let (app, plan) = (options.app.clone(), cluster.display().to_string());
        let board = options.board.built_as().map_or_else(String::new, |board| format!(" --board {board}"));
        let cluster = options.cluster.as_ref().map(|file| format!(" --cluster {}", file.display()));
        let build = format!("cargo xtask build{board}{}", cluster.unwrap_or_default());
        return Ok(Err(Trouble::NoImage { app, plan, there: images_in(folder), build }));
    }
    println!("{}, built for {}", image.display(), cluster.display());
    let (question, calls) = (asks_for_chip(options), act.calls(options, &image));
    if options.dry_run {
        [&question].into_iter().chain(&calls).for_each(|words| println!("{}", shown(words)));
        return Ok(Ok(()));
    }
    let Some(probe_rs) = find_program(PROBE_RS) else { return Ok(Err(Trouble::NoProbeRs)) };
    if options.probe.is_none()
        && let Err(trouble) = one_probe(&probe_rs)?
    {
        return Ok(Err(trouble));
    }
    if let Err(trouble) = right_chip(&probe_rs, &question, options.board)? {
        return Ok(Err(trouble));
    }
    for words in calls {
        println!("{}", shown(&words));
        let (status, complaints) = run::with_complaints(Command::new(&probe_rs).args(&words))?;
        if !status.success() {
            return Ok(Err(Trouble::of_complaints(&complaints, options.board.chip())));
        }
    }
    Ok(Ok(()))
}

/// Whether the chip is that of the board. What cannot be read from the answer is left to the calls that follow.
fn right_chip(probe_rs: &Path, question: &[String], board: Board) -> Result<Result<(), Trouble>> {
    println!("{}", shown(question));
    let output = Command::new(probe_rs).args(question).output();
    let output = output.with_context(|| format!("`{}` cannot be started", probe_rs.display()))?;
    let complaints = String::from_utf8_lossy(&output.stderr);
    eprint!("{complaints}");
    if !output.status.success() {
        return Ok(Err(Trouble::of_complaints(&complaints, board.chip())));
    }
    Ok(match device(&String::from_utf8_lossy(&output.stdout)) {
        Some(device) if device != board.device() => Err(Trouble::OtherChip { wanted: board.chip(), device }),
        _ => Ok(()),
    })
}

/// `probe-rs list` ends with success also where there is none: its text says so.
fn one_probe(probe_rs: &Path) -> Result<Result<(), Trouble>> {
    let output = Command::new(probe_rs).arg("list").stderr(Stdio::inherit()).output();
    let output = output.with_context(|| format!("`{} list` cannot be started", probe_rs.display()))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let probes: Vec<String> = text.lines().filter_map(probe).collect();
    Ok(match probes.len() {
        0 => Err(Trouble::NoProbe),
        1 => Ok(()),
        _ => Err(Trouble::SeveralProbes(probes)),
    })
}

/// A line such as `[0]: STLink V2-1 -- 0483:374b:066DFF48 (ST-LINK)`.
fn probe(line: &str) -> Option<String> {
    let (number, rest) = line.trim().strip_prefix('[')?.split_once("]:")?;
    number.parse::<u32>().ok()?;
    Some(rest.trim().to_owned())
}

fn images_in(folder: &Path) -> Vec<String> {
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A call as one types it.
fn shown(words: &[String]) -> String {
    let quoted = |word: &String| {
        let is_plain = word.chars().all(|it| it.is_ascii_alphanumeric() || "-_./:+=".contains(it));
        if is_plain { word.clone() } else { format!("'{}'", word.replace('\'', r"'\''")) }
    };
    let words: Vec<_> = words.iter().map(quoted).collect();
    format!("{PROBE_RS} {}", words.join(" "))
}

const PROBE_RS: &str = "probe-rs";

#[cfg(test)]
mod tests {
    use super::*;

    fn options(probe: Option<&str>) -> Options {
        Options {
            board: Board::Stm32f4discovery,
            app: "sensor".to_owned(),
            cluster: None,
            probe: probe.map(str::to_owned),
            dry_run: false,
        }
    }

    #[test]
    fn the_calls_are_what_one_would_type() {
        let calls = |act: Act, probe| {
            let calls = act.calls(&options(probe), Path::new("/my target/sensor"));
            calls.iter().map(|words| shown(words)).collect::<Vec<_>>()
        };
        assert_eq!(
            calls(Act::Flash, None),
            [
                "probe-rs download --chip STM32F407VG --verify '/my target/sensor'",
                "probe-rs reset --chip STM32F407VG"
            ]
        );
        assert_eq!(
            calls(Act::Attach, Some("0483:374b")),
            ["probe-rs attach --chip STM32F407VG --probe 0483:374b '/my target/sensor'"]
        );
    }

    #[test]
    fn probes_are_counted_by_their_lines() {
        assert_eq!(
            probe("[0]: STLink V2 -- 0483:3748 (ST-LINK)").as_deref(),
            Some("STLink V2 -- 0483:3748 (ST-LINK)")
        );
        assert_eq!(probe("The following debug probes were found:"), None);
        assert_eq!(probe("No debug probes were found."), None);
    }

    #[test]
    fn the_device_is_read_from_a_table_and_from_a_list() {
        assert_eq!(device("e0042000: 10076413\n"), Some(0x413));
        assert_eq!(device("10006421\n"), Some(0x421));
        assert_eq!(device(""), None);
        assert_eq!(device("zzzzzzzz"), None);
    }
}
