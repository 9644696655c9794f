//! Walks `docs/tasks/one-file-for-every-tool.md` as a reader does: from the description of a cluster, in a repository
//! outside this one, to firmware, judge, and the tools of others.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Command};

use anyhow::{Context as _, Result, bail, ensure};

use crate::apps;
use crate::demo;
use crate::images::PROFILE;
use crate::plan;
use crate::run::step;
use crate::setup;
use crate::tally::Tally;
use crate::target::{TRIPLE, TargetWay};
use crate::tools;
use crate::workspace::Workspace;

/// Walks it in a folder of its own, which shares the build products of this repository.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    let way = setup::prepare(&[])?;
    tools::prepare(workspace)?;
    let rover = env::temp_dir().join(format!("cosmic-rover-{}", process::id()));
    let walk = Walk { workspace, rover: rover.clone() };
    let mut tally = step("walking from one file to every tool", || walk.go());
    if let Ok(tally) = &mut tally {
        tally.add(elf_files(workspace, &way, &rover));
        tally.add(written_again(workspace, &way, &rover));
    }
    // What a test leaves behind is no failure.
    let _ = fs::remove_dir_all(&rover);
    tally
}

struct Walk<'w> {
    workspace: &'w Workspace,
    rover: PathBuf,
}

impl Walk<'_> {
    /// Every command of the page, in its order. The first that does not do what the page says ends the walk.
    fn go(&self) -> Result<Tally> {
        let page = self.workspace.root().join(PAGE);
        let page = fs::read_to_string(&page).with_context(|| format!("reading {}", page.display()))?;
        self.check_program(&page)?;
        let mut tally = Tally::default();
        for command in commands(&page) {
            let held = self.call(command).and_then(|printed| self.judge(command, &printed));
            if let Err(error) = &held {
                eprintln!("error: {PAGE}, `{command}`: {error:#}");
            }
            tally.add(Ok(Tally::one(held.is_ok())));
            if held.is_err() {
                break;
            }
        }
        Ok(tally)
    }

    /// The program that the page shows is the file that it calls.
    fn check_program(&self, page: &str) -> Result<()> {
        let program = fs::read_to_string(self.workspace.root().join(PROGRAM))?;
        ensure!(blocks(page, "python").next() == Some(program.as_str()), "{PAGE} does not show {PROGRAM}");
        Ok(())
    }

    /// What a command prints.
    fn call(&self, command: &str) -> Result<String> {
        println!("==> {command}");
        let mut path = self.workspace.target_dir().join("tools/bin").into_os_string();
        path.push(":");
        path.push(env::var_os("PATH").unwrap_or_default());
        let output = Command::new("sh")
            .args(["-c", &command.replace(PLACE, &self.rover.display().to_string())])
            .current_dir(self.workspace.root())
            .env("CARGO_TARGET_DIR", self.workspace.target_dir())
            .env("PATH", path)
            .env("PYTHONIOENCODING", "utf-8")
            .stderr(process::Stdio::inherit())
            .output()
            .context("sh cannot be started")?;
        ensure!(output.status.success(), "ended with {}", output.status);
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// Whether a command did what the page says of it.
    fn judge(&self, command: &str, printed: &str) -> Result<()> {
        let lines: Vec<&str> = printed.lines().filter(|line| !line.trim().is_empty()).collect();
        if command.contains("xtask new") {
            return Ok(());
        }
        if command.contains("xtask demo") {
            ensure!(printed.contains("\nPASSED"), "it did not pass:\n{printed}");
            let trace: serde_json::Value =
                serde_json::from_slice(&fs::read(self.rover.join("out/trace.json"))?)?;
            let events = trace["traceEvents"].as_array().map_or(0, Vec::len);
            ensure!(events > 1_000, "the trace has {events} events");
            return Ok(());
        }
        if command.contains("export") {
            ensure!(self.rover.join("tools/rover.html").is_file(), "there is no rover.html");
            return Ok(());
        }
        let (frames, events) = self.frames()?;
        // Each line that is a frame in words, and how many there must be.
        let (is_said, expected): (fn(&str) -> bool, usize) = match command {
            _ if command.contains("cantools") => {
                (|line| line.contains(" :: ") && !line.contains("Unknown"), frames)
            }
            _ if command.contains("tshark") => {
                (|line| line.contains(" COSMIC ") && !line.contains("COSMIC,"), frames)
            }
            _ if command.contains("events.py") => (|_| true, events),
            _ if command.contains("cosmic-cli") => (
                |line| !["malformed", "no message", "etag "].iter().any(|wrong| line.contains(wrong)),
                frames,
            ),
            _ => bail!("nothing is known of what it should do"),
        };
        let said = lines.iter().filter(|line| is_said(line)).count();
        ensure!(said == expected, "{said} of {expected} frames are decoded");
        let channels = channels(&self.rover.join(plan::OF_A_REPOSITORY))?;
        let missing =
            channels.iter().find(|channel| !lines.iter().any(|line| line.contains(channel.as_str())));
        ensure!(missing.is_none(), "no event of {}", missing.map_or("", String::as_str));
        Ok(())
    }

    /// How many frames the log of the bus has, and how many of them are events.
    fn frames(&self) -> Result<(usize, usize)> {
        let log = fs::read_to_string(self.rover.join("out/candump.log"))?;
        let etag = |line: &str| {
            let id = line.split_whitespace().nth(2)?.split('#').next()?;
            u32::from_str_radix(id, 16).ok().map(|id| (id < ERROR_FRAME).then_some(id & 0x3FFF))
        };
        let etags: Option<Vec<_>> = log.lines().map(etag).collect();
        let etags: Vec<_> = etags.context("the log has lines that are none")?.into_iter().flatten().collect();
        ensure!(etags.len() > 1_000, "only {} frames", etags.len());
        Ok((etags.len(), etags.iter().filter(|etag| **etag >= FIRST_OF_CHANNELS).count()))
    }
}

/// The images of the rover, named one by one; one of them is not called like its node.
fn elf_files(workspace: &Workspace, way: &TargetWay, rover: &Path) -> Result<Tally> {
    let images = way.target_dir(workspace).join(TRIPLE).join(PROFILE);
    let other = rover.join("out/older.elf");
    fs::copy(images.join("power"), &other).with_context(|| format!("writing {}", other.display()))?;
    let word = |path: PathBuf| path.display().to_string();
    let cluster = word(rover.join(plan::OF_A_REPOSITORY));
    let mut arguments: Vec<String> =
        ["--seconds", "1", "--out", &word(rover.join("out")), "--cluster", &cluster]
            .map(str::to_owned)
            .into();
    arguments.extend(["base", "left_motor", "right_motor", "imu", "arm"].map(|name| word(images.join(name))));
    let without = demo::run(workspace, &arguments)?;
    arguments.push(format!("power={}", other.display()));
    let code = demo::run(workspace, &arguments)?;
    Ok(Tally::one((without, code) == (2, 0)))
}

/// A description that was written again, but is the same, is no reason to build; one that has changed is, though it is
/// as old as before.
fn written_again(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let cluster = plan::find(folder.join(plan::OF_A_REPOSITORY))?;
    let old = fs::metadata(&cluster)?.modified()?;
    let text = fs::read_to_string(&cluster).with_context(|| format!("reading {}", cluster.display()))?;
    let build = || apps::build(way, folder, &cluster, Some(workspace.target_dir()));
    fs::write(&cluster, &text).with_context(|| format!("writing {}", cluster.display()))?;
    let compiled = build()?.compiled;
    if compiled > 0 {
        eprintln!("error: {compiled} images were built again for a description that has not changed");
    }
    fs::write(&cluster, text.replacen("\nperiod = ", "\nperoid = ", 1))
        .with_context(|| format!("writing {}", cluster.display()))?;
    fs::File::options().write(true).open(&cluster)?.set_modified(old)?;
    let is_seen = build().is_err();
    if !is_seen {
        eprintln!("error: a description that has changed was not planned again");
    }
    Ok(Tally::one(compiled == 0 && is_seen))
}

/// The lines of its blocks of shell.
fn commands(page: &str) -> impl Iterator<Item = &str> {
    blocks(page, "sh").flat_map(str::lines)
}

fn blocks<'p>(page: &'p str, language: &str) -> impl Iterator<Item = &'p str> {
    let start = format!("```{language}\n");
    let starts: Vec<_> = page.match_indices(&start).map(|(at, _)| at + start.len()).collect();
    starts.into_iter().filter_map(|at| page[at..].split("```").next())
}

/// The names of the channels in a description.
fn channels(cluster: &Path) -> Result<Vec<String>> {
    let text = fs::read_to_string(cluster).with_context(|| format!("reading {}", cluster.display()))?;
    let names = text.split("[[channel]]\nname = \"").skip(1).filter_map(|rest| rest.split('"').next());
    Ok(names.map(str::to_owned).collect())
}

const PAGE: &str = "docs/tasks/one-file-for-every-tool.md";
const PROGRAM: &str = "docs/tasks/events.py";
/// Where the page has the rover.
const PLACE: &str = "/tmp/rover";
/// Identifiers of Linux's error frames: an attempt that was destroyed.
const ERROR_FRAME: u32 = 1 << 29;
/// Etags below are those of the protocol.
const FIRST_OF_CHANNELS: u32 = 100;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_a_command_for_each_tool() {
        let workspace = Workspace::find().unwrap();
        let page = fs::read_to_string(workspace.root().join(PAGE)).unwrap();
        let all: Vec<_> = commands(&page).collect();
        for tool in ["xtask new", "xtask demo", "export", "cantools", "tshark", "events.py", "cosmic-cli"] {
            assert_eq!(all.iter().filter(|command| command.contains(tool)).count(), 1, "{tool}");
        }
        let walk = Walk { workspace: &workspace, rover: PathBuf::new() };
        walk.check_program(&page).unwrap();
        assert_eq!(channels(&workspace.root().join("cosmic-plan/examples/rover.toml")).unwrap().len(), 8);
    }
}
