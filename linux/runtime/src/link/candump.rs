//! A log of `candump -l`, replayed: what it holds arrives at the node as it did then.
//!
//! ```text
//! (1.000128) can0 1F5FC004#1122334455667788
//! ```
//!
//! The first frame arrives at once, the others at the distances that the log states; a log whose time goes back is
//! replayed on without a pause. What the node sends goes nowhere, and is counted ([`LinkCounters::unsent`]). At its end
//! the link stays quiet.
//!
//! [`LinkCounters::unsent`]: super::LinkCounters::unsent

use std::path::PathBuf;

use cosmic_core::can::Outcome;
use tokio::fs::File;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader};
use tokio::time::Instant;

use super::{Link, LinkError, Port};
use crate::candump::{Entry, PCAPNG};
use crate::tap::What;

/// A log that is replayed once.
#[derive(Clone, Debug)]
pub struct Candump {
    path: PathBuf,
    interface: Option<String>,
    speed: f64,
}

impl Candump {
    /// The log in this file.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), interface: None, speed: 1.0 }
    }

    /// Only what the log has of this interface, such as `can0`.
    pub fn interface(self, interface: impl Into<String>) -> Self {
        Self { interface: Some(interface.into()), ..self }
    }

    /// So many times as fast as it was; a factor that is no positive number is taken for 1.
    pub fn speed(self, factor: f64) -> Self {
        Self { speed: if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }, ..self }
    }

    fn failed(&self, what: &str, error: &std::io::Error) -> LinkError {
        LinkError::last(format!("log {}: {what}: {error}", self.path.display()))
    }

    /// # Errors
    /// It cannot be opened, or is no such log.
    async fn open(&self) -> Result<BufReader<File>, LinkError> {
        let file = File::open(&self.path).await.map_err(|error| self.failed("cannot be opened", &error))?;
        // Of a pipe, who writes it may come later.
        let is_whole = file.metadata().await.is_ok_and(|data| data.is_file());
        let mut reader = BufReader::new(file);
        if !is_whole {
            return Ok(reader);
        }
        let start = reader.fill_buf().await.map_err(|error| self.failed("cannot be read", &error))?;
        if start.starts_with(&PCAPNG) {
            let name = self.path.display();
            return Err(LinkError::last(format!(
                "log {name}: it is pcapng, which a node does not replay: write it anew as candump has it (`cosmic record \
                 {name}.log --link log:{name}`)"
            )));
        }
        Ok(reader)
    }

    async fn replay(&self, mut reader: BufReader<File>, port: &Port) -> LinkError {
        let name = self.path.display();
        let mut first = None;
        loop {
            let mut line = Vec::new();
            // A line that is longer is read in pieces, which mean nothing.
            match (&mut reader).take(Entry::LONGEST).read_until(b'\n', &mut line).await {
                Ok(0) => return LinkError::last(format!("log {name}: replayed to its end")),
                Ok(_) => {}
                Err(error) => return self.failed("cannot be read", &error),
            }
            let line = line.trim_ascii();
            if line.is_empty() {
                continue;
            }
            let Some(entry) = Entry::parse(line) else {
                port.malformed();
                continue;
            };
            if self.interface.as_ref().is_some_and(|wanted| wanted != entry.interface) {
                continue;
            }
            let &mut (start, origin) = first.get_or_insert((Instant::now(), entry.stamp));
            let since = entry.stamp.saturating_sub(origin).div_f64(self.speed);
            tokio::time::sleep_until(start + since).await;
            match entry.what {
                What::Frame(frame) => port.received(&frame),
                What::BusOff => port.bus_off(),
                What::Errors(errors) => port.errors(errors),
                _ => port.foreign(),
            }
        }
    }
}

impl Link for Candump {
    async fn run(&mut self, port: &Port) -> LinkError {
        let log = match self.open().await {
            Ok(log) => log,
            Err(error) => return error,
        };
        port.connected();
        let swallow = async {
            loop {
                let (mailbox, _) = port.next_frame().await;
                port.unsent();
                port.conclude(mailbox, Outcome::Sent);
            }
        };
        let ended = {
            let mut swallow = std::pin::pin!(swallow);
            tokio::select! {
                error = self.replay(log, port) => error,
                () = &mut swallow => LinkError::last("the log has ended"),
            }
        };
        tracing::info!("{ended}");
        // The node goes on without a bus.
        loop {
            let (mailbox, _) = port.next_frame().await;
            port.unsent();
            port.conclude(mailbox, Outcome::Sent);
        }
    }
}
