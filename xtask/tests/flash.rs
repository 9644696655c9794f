//! `cargo xtask flash` and `attach`, with a program in the place of probe-rs that says what one would say.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder of build products with one image, and one for the false probe-rs.
struct Desk(PathBuf);

impl Desk {
    fn new(name: &str) -> Self {
        let desk = Self(std::env::temp_dir().join(format!("xtask-flash-{name}-{}", std::process::id())));
        let _ = fs::remove_dir_all(&desk.0);
        fs::create_dir_all(desk.0.join("bin")).unwrap();
        fs::create_dir_all(desk.0.join("target/images/vehicle")).unwrap();
        fs::write(desk.image(), "an image").unwrap();
        desk
    }

    fn image(&self) -> PathBuf {
        self.0.join("target/images/vehicle/sensor")
    }

    /// A probe-rs that lists these probes, and does this otherwise.
    fn with_probe_rs(self, list: &str, otherwise: &str) -> Self {
        self.with(list, otherwise, F405, "")
    }

    /// The same, on a board with another chip. If it is `broken` already the chip cannot be read.
    fn with(self, list: &str, otherwise: &str, device: &str, broken: &str) -> Self {
        let log = self.0.join("calls");
        let script = format!(
            "#!/bin/sh\necho \"$@\" >> '{}'\nif [ \"$1\" = list ]; then printf '{list}'; exit 0; fi\n\
             if [ \"$1\" = read ] && [ -z '{broken}' ]; then echo 'e0042000: {device}'; exit 0; fi\n{otherwise}\n",
            log.display()
        );
        let file = self.0.join("bin/probe-rs");
        fs::write(&file, script).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
        self
    }

    fn xtask(&self, arguments: &[&str]) -> Output {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
        command.current_dir(root).args(arguments).env("CARGO_TARGET_DIR", self.0.join("target"));
        // No other probe-rs than the false one.
        command.env("PATH", self.0.join("bin"));
        command.output().unwrap()
    }

    fn flash(&self, more: &[&str]) -> (Option<i32>, String, String) {
        let arguments =
            [["flash", "--board", "stm32f4discovery", "--app", "sensor"].as_slice(), more].concat();
        let output = self.xtask(&arguments);
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    }

    fn calls(&self) -> String {
        fs::read_to_string(self.0.join("calls")).unwrap_or_default()
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const READ: &str = "read --chip STM32F407VG b32 0xE0042000 1";
/// What a part of the F405 and F407 reads as.
const F405: &str = "10076413";
const F446: &str = "10006421";
const ONE: &str = "The following debug probes were found:\\n[0]: STLink V2 -- 0483:3748 (ST-LINK)\\n";

#[test]
fn an_image_is_written_and_started() {
    let desk = Desk::new("works").with_probe_rs(ONE, "exit 0");
    let (code, said, complained) = desk.flash(&[]);
    assert_eq!(code, Some(0), "{complained}");
    assert!(said.contains("built for") && said.contains("vehicle.toml"), "{said}");
    let image = desk.image();
    let expected = format!(
        "list\n{READ}\ndownload --chip STM32F407VG --verify {}\nreset --chip STM32F407VG\n",
        image.display()
    );
    assert_eq!(desk.calls(), expected);
}

#[test]
fn a_dry_run_prints_the_commands_and_does_nothing() {
    let desk = Desk::new("dry").with_probe_rs("", "exit 1");
    let (code, said, _) = desk.flash(&["--dry-run", "--probe", "0483:3748"]);
    assert_eq!(code, Some(0));
    let image = desk.image();
    let download =
        format!("\nprobe-rs download --chip STM32F407VG --probe 0483:3748 --verify {}\n", image.display());
    assert!(said.contains(&download), "{said}");
    assert!(
        said.contains("\nprobe-rs read --chip STM32F407VG --probe 0483:3748 b32 0xE0042000 1\n"),
        "{said}"
    );
    assert!(said.ends_with("probe-rs reset --chip STM32F407VG --probe 0483:3748\n"), "{said}");
    assert_eq!(desk.calls(), "");
}

/// One line, and a code of its own.
fn fails(desk: &Desk, more: &[&str], expected: i32, words: &str) {
    let (code, _, complained) = desk.flash(more);
    assert_eq!(code, Some(expected), "{complained}");
    let line = complained.lines().rfind(|line| line.starts_with("error: ")).unwrap_or_default();
    assert!(line.contains(words), "{complained}");
    assert_eq!(complained.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{complained}");
}

#[test]
fn what_is_wrong_is_told_in_a_line_with_a_code() {
    fails(
        &Desk::new("no-probe").with_probe_rs("No debug probes were found.\\n", ""),
        &[],
        12,
        "no debug probe",
    );
    let two = format!("{ONE}[1]: J-Link -- 1366:0101:000123 (J-Link)\\n");
    let several = Desk::new("several").with_probe_rs(&two, "exit 0");
    fails(&several, &[], 13, "1366:0101:000123");
    assert_eq!(several.flash(&["--probe", "1366:0101:000123"]).0, Some(0));
    let complains = |name: &str, text: &str| {
        Desk::new(name).with(ONE, &format!("echo '{text}' >&2; exit 1"), F405, "yes")
    };
    fails(&complains("locked", "Error: the device is locked: readout protection"), &[], 15, "locked");
    fails(
        &complains("chip", "Error: the connected chip does not match STM32F407VG"),
        &[],
        14,
        "no STM32F407VG",
    );
    // Of a probe that was pulled out meanwhile, and of one that --probe names and is not there.
    fails(&complains("gone", "Error: No connected probes were found."), &[], 12, "no debug probe");
    let other = ["--probe", "1209:4853"];
    fails(&complains("not-there", "Caused by: 1: Probe was not found."), &other, 12, "no debug probe");
    fails(&complains("more", "Error: 2 probes were found: ..."), &other, 13, "several debug probes");
    fails(&complains("other", "Error: something else broke"), &[], 16, "something else broke");
}

/// probe-rs believes what `--chip` says, and would write into any chip of the family.
#[test]
fn another_chip_is_found_out_before_anything_is_written() {
    let desk = Desk::new("other-chip").with(ONE, "exit 0", F446, "");
    fails(&desk, &[], 14, "no STM32F407VG (its device id is 0x421)");
    assert_eq!(desk.calls(), format!("list\n{READ}\n"));
}

#[test]
fn what_is_wrong_when_attaching_is_told_in_the_same_way() {
    let attach = |desk: &Desk| {
        let output = desk.xtask(&["attach", "--board", "stm32f4discovery", "--app", "sensor"]);
        let complained = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(complained.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{complained}");
        output.status.code()
    };
    assert_eq!(attach(&Desk::new("a-none")), Some(11));
    assert_eq!(
        attach(&Desk::new("a-no-probe").with_probe_rs("No debug probes were found.\\n", "")),
        Some(12)
    );
    let two = format!("{ONE}[1]: J-Link -- 1366:0101:000123 (J-Link)\\n");
    assert_eq!(attach(&Desk::new("a-two").with_probe_rs(&two, "exit 0")), Some(13));
    assert_eq!(attach(&Desk::new("a-chip").with(ONE, "exit 0", F446, "")), Some(14));
    let locked = "echo 'lacked the permission to do so: erase_all' >&2; exit 1";
    assert_eq!(attach(&Desk::new("a-locked").with_probe_rs(ONE, locked)), Some(15));
}

#[test]
fn an_image_that_is_not_there_is_named_with_those_that_are() {
    let desk = Desk::new("no-image").with_probe_rs(ONE, "exit 0");
    for app in ["brake", "../vehicle/sensor", ""] {
        let output = desk.xtask(&["flash", "--board", "stm32-h405", "--app", app]);
        assert_eq!(output.status.code(), Some(10));
        assert!(String::from_utf8_lossy(&output.stderr).contains("there are sensor"));
    }
    assert_eq!(desk.calls(), "");
}

#[test]
fn without_probe_rs_the_way_to_it_is_told() {
    fails(&Desk::new("none"), &[], 11, "cargo install probe-rs-tools");
}

#[test]
fn a_node_that_runs_shows_its_log() {
    let desk = Desk::new("attach").with_probe_rs(ONE, "exit 0");
    let output = desk.xtask(&["attach", "--board", "stm32-h405", "--app", "sensor"]);
    assert_eq!(output.status.code(), Some(0));
    let read = READ.replace("F407VG", "F405RG");
    assert_eq!(desk.calls(), format!("list\n{read}\nattach --chip STM32F405RG {}\n", desk.image().display()));
}
