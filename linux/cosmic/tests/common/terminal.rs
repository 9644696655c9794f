//! A program on a terminal of its own.

use std::io::{Read as _, Write as _};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use portable_pty::{CommandBuilder, MasterPty, PtySize, native_pty_system};

use super::root;

/// A program on a terminal of its own.
pub(crate) struct Terminal {
    screen: vt100::Parser,
    bytes: Receiver<Vec<u8>>,
    pub(crate) raw: Vec<u8>,
    keys: Box<dyn std::io::Write + Send>,
    child: Box<dyn portable_pty::Child + Send + Sync>,
    _master: Box<dyn MasterPty + Send>,
}

impl Terminal {
    pub(crate) fn start(arguments: &[&str], environment: &[(&str, &str)], (rows, cols): (u16, u16)) -> Self {
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
    pub(crate) fn shows(&mut self, wanted: &str) -> String {
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

    pub(crate) fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Waits for the end; returns the exit code.
    pub(crate) fn ends(&mut self) -> u32 {
        let begun = Instant::now();
        loop {
            while let Ok(bytes) = self.bytes.try_recv() {
                self.raw.extend(bytes);
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                // What it wrote last may still be on its way; behind it the reader ends.
                while let Ok(bytes) = self.bytes.recv_timeout(Duration::from_secs(60)) {
                    self.raw.extend(bytes);
                }
                return status.exit_code();
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
