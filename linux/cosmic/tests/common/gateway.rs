//! A gateway as its users start it, with segments of the rover.

use std::io::{BufRead as _, BufReader};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use super::{CLUSTER, Running, Segment, root};

/// A gateway that runs, and what it logs.
pub(crate) struct Gateway {
    _program: Running,
    log: Receiver<String>,
    _folder: tempfile::TempDir,
    listen: u16,
}

impl Gateway {
    /// Joins these segments; `more` stands before them in the configuration.
    pub(crate) fn start(segments: &[(&str, &Segment)], more: &str) -> Self {
        Self::start_at("tcp", segments, more)
    }

    pub(crate) fn start_at(protocol: &str, segments: &[(&str, &Segment)], more: &str) -> Self {
        let (folder, listen) = (tempfile::tempdir().unwrap(), port());
        let mut text = format!("network = \"test\"\n{more}\n");
        if !more.contains("[ip]") {
            text += &format!("[ip]\nlisten = [\"{protocol}/127.0.0.1:{listen}\"]\n");
        }
        text = text.replace("@PORT", &listen.to_string());
        for (number, (name, segment)) in segments.iter().enumerate() {
            text += &of_segment(name, &segment.link(), number);
        }
        text += GRIPPER;
        let file = folder.path().join("gateway.toml");
        std::fs::write(&file, text).unwrap();
        let mut program = Running::start(&["gateway", file.to_str().unwrap()]);
        let (sender, log) = channel();
        let said = BufReader::new(program.0.stderr.take().unwrap());
        std::thread::spawn(move || {
            said.lines().map_while(Result::ok).for_each(|line| {
                // The test may have ended.
                let _ = sender.send(line);
            });
        });
        Self { _program: program, log, _folder: folder, listen }
    }

    /// What stands behind this in the log, when it does.
    pub(crate) fn says(&self, wanted: &str) -> String {
        loop {
            let line =
                self.log.recv_timeout(Duration::from_secs(60)).expect("the gateway says so in a minute");
            if let Some((_, rest)) = line.split_once(wanted) {
                return rest.to_owned();
            }
        }
    }

    /// What `--link` takes.
    pub(crate) fn link(&self, protocol: &str) -> String {
        format!("zenoh:{protocol}/127.0.0.1:{}", self.listen)
    }
}

fn of_segment(name: &str, link: &str, number: usize) -> String {
    let plan = root().join(CLUSTER);
    format!(
        "[[segment]]\nname = \"{name}\"\nlink = \"{link}\"\nuid = \"0x6A7E{number:04X}\"\ntx-node = {}\nplan = {plan:?}\n\
         etags = {{ gateways = 5000 }}\n",
        90 + number
    )
}

/// A port that nobody listens at.
pub(crate) fn port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Somebody who publishes on the segment, again and again, until he is dropped.
pub(crate) fn publisher(segment: &Segment) -> Running {
    Running::start(&[
        "pub",
        "gripper",
        "state=open",
        "force=3.5",
        "-n",
        "1000000",
        "--every",
        "20ms",
        "--tx-node",
        "5",
        "--deadline",
        "10s",
        "--validity",
        "20s",
        "-c",
        CLUSTER,
        "-l",
        &segment.link(),
        "--patience",
        "50s",
    ])
}

/// The deadlines are so long that no slow machine breaks them.
const GRIPPER: &str = r#"
[[channel]]
name = "gripper"
subject = "0xB0A01C0000000006"
class = "soft"
deadline = "10 s"
validity = "20 s"
interval = "5 ms"
burst = 10
longest-wait = "10 ms"
unasked = ["east"]
from = ["west"]
"#;
