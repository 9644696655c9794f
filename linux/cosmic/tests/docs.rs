//! What the pages of `docs/tasks` show is what the command prints. `UPDATE_DOCS=1` writes it anew.
//!
//! A block of ```` ```console ```` holds commands (`$ cosmic ..`) with what they print behind them, and the exit code if
//! it is not 0 (`[exit code 1]`). A block of ```` ```sh ```` with `export NAME=value` sets what the commands behind it
//! find in their environment. `| head -3` shows three lines.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use common::{cosmic, late_log, root, rover_log, text};

fn updates() -> bool {
    std::env::var_os("UPDATE_DOCS").is_some()
}

/// A file is what was made; or it is written.
fn held(path: &Path, made: &str) {
    if updates() {
        fs::write(path, made).unwrap();
        return;
    }
    let found = fs::read_to_string(path).unwrap_or_default();
    let differs = found.lines().zip(made.lines()).position(|(found, made)| found != made);
    assert!(
        found == made,
        "{} is not what is printed, from line {} on: UPDATE_DOCS=1 cargo test -p cosmic-cli --test docs",
        path.display(),
        differs.map_or(found.lines().count().min(made.lines().count()), |line| line) + 1
    );
}

#[test]
fn the_pages_show_what_is_printed() {
    let folder = root().join("docs/tasks");
    held(&folder.join("rover.log"), &rover_log());
    held(&folder.join("late.log"), &late_log());
    let pages =
        ["watch-a-running-cluster.md", "find-why-an-event-was-late.md", "record-and-replay-a-fault.md"];
    for page in pages.map(|page| folder.join(page)) {
        let written = fs::read_to_string(&page).unwrap();
        held(&page, &as_printed(&written));
    }
}

/// The page, with what its commands print now.
fn as_printed(page: &str) -> String {
    let mut out = String::new();
    let mut environment = BTreeMap::new();
    let temporary = tempfile::tempdir().unwrap();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        out += line;
        out += "\n";
        if line != "```console" && line != "```sh" {
            continue;
        }
        let block: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
        for inner in &block {
            let assignments = inner.strip_prefix("export ").into_iter().flat_map(str::split_whitespace);
            environment.extend(
                assignments
                    .filter_map(|word| word.split_once('='))
                    .map(|(name, value)| (name.to_owned(), value.to_owned())),
            );
        }
        match line {
            "```sh" => block.iter().for_each(|inner| out += &format!("{inner}\n")),
            _ => block
                .iter()
                .filter(|inner| inner.starts_with("$ "))
                .for_each(|command| out += &console(command, &environment, temporary.path())),
        }
        out += "```\n";
    }
    out
}

fn console(command: &str, environment: &BTreeMap<String, String>, temporary: &Path) -> String {
    let (called, lines) = command.split_once(" | head -").unwrap_or((command, "1000"));
    let words: Vec<String> = called["$ cosmic ".len()..]
        .split_whitespace()
        .map(|word| word.replace("/tmp", &temporary.display().to_string()))
        .collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let output = cosmic(&words).envs(environment).output().unwrap();
    let lines: usize = lines.parse().unwrap();
    let shown: String = text(&output.stdout).lines().take(lines).map(|line| format!("{line}\n")).collect();
    let mut printed = format!("{command}\n{shown}{}", text(&output.stderr));
    printed = printed.replace(&temporary.display().to_string(), "/tmp");
    match output.status.code() {
        Some(0) => {}
        code => printed += &format!("[exit code {}]\n", code.unwrap_or(-1)),
    }
    printed
}
