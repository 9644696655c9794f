//! `cosmic top`, and colours, on a pseudo terminal: what a person sees.

mod common;

use std::io::{Read as _, Write as _};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use common::{CLUSTER, root};
use portable_pty::{CommandBuilder, MasterPty, PtySize, native_pty_system};

const LOG: &str = "log:docs/tasks/late.log";

/// A program on a terminal of its own.
struct Terminal {
    screen: vt100::Parser,
    bytes: Receiver<Vec<u8>>,
    raw: Vec<u8>,
    keys: Box<dyn std::io::Write + Send>,
    child: Box<dyn portable_pty::Child + Send + Sync>,
    _master: Box<dyn MasterPty + Send>,
}

impl Terminal {
    fn start(arguments: &[&str], environment: &[(&str, &str)], (rows, cols): (u16, u16)) -> Self {
        let pair =
            native_pty_system().openpty(PtySize { rows, cols, pixel_width: 0, pixel_height: 0 }).unwrap();
        let mut command = CommandBuilder::new(env!("CARGO_BIN_EXE_cosmic"));
        command.args(arguments);
        command.cwd(root());
        command.env("TERM", "xterm-256color");
        command.env_remove("NO_COLOR");
        environment.iter().for_each(|(name, value)| command.env(name, value));
        let child = pair.slave.spawn_command(command).unwrap();
        drop(pair.slave);
        let mut reader = pair.master.try_clone_reader().unwrap();
        let keys = pair.master.take_writer().unwrap();
        let (sender, bytes) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut buffer) {
                let _ = sender.send(buffer[..count].to_vec());
            }
        });
        let size = |length| std::num::NonZeroU16::new(length).unwrap();
        let screen = vt100::Parser::new(size(rows), size(cols), 0);
        Self { screen, bytes, raw: Vec::new(), keys, child, _master: pair.master }
    }

    /// Waits until the screen holds this; returns the screen.
    fn shows(&mut self, wanted: &str) -> String {
        let begun = Instant::now();
        loop {
            let screen = self.screen.screen().contents();
            if screen.contains(wanted) {
                return screen;
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "in a minute not {wanted:?}:\n{screen}");
            if let Ok(bytes) = self.bytes.recv_timeout(Duration::from_millis(100)) {
                self.screen.process(&bytes);
                self.raw.extend(bytes);
            }
        }
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Waits for the end; returns the exit code.
    fn ends(&mut self) -> u32 {
        let begun = Instant::now();
        loop {
            while let Ok(bytes) = self.bytes.try_recv() {
                self.raw.extend(bytes);
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.exit_code();
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn top_shows_the_segment_and_answers_keys() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (36, 120));
    let screen = top.shows("the log has ended");
    for wanted in [
        "cosmic top: rover",
        "500 kbit/s",
        "HRT ",
        "SRT ",
        "NRT ",
        "foreign ",
        "load, last minute",
        "time of base within",
        "7 nodes",
        "left_motor",
        "operational",
        "9 channels",
        "attitude",
        "gripper",
        "state=holding force=12.5 N",
        "notices, newest first",
        "unplanned publisher: node 70",
    ] {
        assert!(screen.contains(wanted), "{wanted}\n{screen}");
    }
    top.press("d");
    let screen = top.shows("add the channel to the node's `publishes`");
    assert!(screen.contains("doctor"), "{screen}");
    top.press("\x1b");
    top.press("?");
    top.shows("Tab, Shift-Tab");
    top.press("?");
    // Down in the list of channels: the first of them is out of sight.
    top.press("\t\t\t");
    top.press("q");
    assert_eq!(top.ends(), 0);
    // The terminal is as it was: the other screen is left, and the cursor is back.
    let raw = String::from_utf8_lossy(&top.raw).into_owned();
    assert!(raw.contains("\x1b[?1049l") && raw.contains("\x1b[?25h"), "{raw:?}");
}

#[test]
fn top_fits_a_small_terminal_and_ends_on_control_c() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (24, 80));
    let screen = top.shows("the log has ended");
    for wanted in ["cosmic top: rover", "nodes", "channels", "notices", "q quit"] {
        assert!(screen.contains(wanted), "{wanted}\n{screen}");
    }
    top.press("\x03");
    assert_eq!(top.ends(), 0);
}

#[test]
fn top_scrolls_what_has_the_focus() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (24, 100));
    let screen = top.shows("the log has ended");
    assert!(screen.contains("▸9 channels"), "{screen}");
    top.press("jj");
    top.shows("▸9 channels from 3");
    top.press("\t");
    top.shows("notices, newest first");
    top.press("q");
    assert_eq!(top.ends(), 0);
}

#[test]
fn tables_have_colours_on_a_terminal_but_not_with_no_color() {
    let nodes = ["nodes", "-l", LOG, "-c", CLUSTER];
    let mut coloured = Terminal::start(&nodes, &[], (40, 160));
    coloured.shows("power");
    assert_eq!(coloured.ends(), 0);
    assert!(String::from_utf8_lossy(&coloured.raw).contains("\x1b[32moperational\x1b[0m"));
    let mut plain = Terminal::start(&nodes, &[("NO_COLOR", "1")], (40, 160));
    plain.shows("power");
    assert_eq!(plain.ends(), 0);
    assert!(!String::from_utf8_lossy(&plain.raw).contains('\x1b'));
}

#[test]
fn top_without_colours_says_the_same_in_words() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[("NO_COLOR", "1")], (36, 120));
    top.shows("the log has ended");
    top.press("q");
    assert_eq!(top.ends(), 0);
    let raw = String::from_utf8_lossy(&top.raw).into_owned();
    assert!(
        !raw.contains("\x1b[38;5;") && !raw.contains("\x1b[31m") && !raw.contains("\x1b[33m"),
        "no colour is set"
    );
}
