//! A simulated or emulated segment in real time, over a Unix socket: several programs share it.
//!
//! A [server](serve) holds a [`Segment`], a bus in virtual time, and lets that time pass as the wall clock does. Each
//! connection is a station on the bus, with three mailboxes, out of which frames can be withdrawn: nothing of what a
//! controller does is lost on this link. A station of the server's own acknowledges every frame, so that a node that is
//! alone can send.
//!
//! Records of 24 bytes go both ways; see [`Record`].

mod bus;
mod outgoing;
mod record;
mod server;
mod socket;
mod time;

pub use bus::{Member, MemberEvent, Segment, SimulatedSegment};
pub use record::{Record, VERSION};
pub use server::{Options, serve};
pub use socket::{ServeError, Socket};

use std::path::PathBuf;
use std::sync::Arc;

use cosmic_core::can::{ErrorCounters, Frame, Outcome};
use tokio::io::{AsyncReadExt as _, BufReader};
use tokio::net::UnixStream;

use super::{Link, LinkError, Port};
use outgoing::{Records, Way};

/// The link to a segment that is served at a socket.
#[derive(Clone, Debug)]
pub struct SegmentLink {
    path: PathBuf,
}

impl SegmentLink {
    /// The segment whose server listens there.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    fn error(&self, what: impl std::fmt::Display) -> LinkError {
        LinkError::new(format!("segment at {}: {what}", self.path.display()))
    }

    async fn carry(&self, port: &Port) -> Result<(), LinkError> {
        let connected = UnixStream::connect(&self.path).await;
        let stream = connected.map_err(|error| self.error(format_args!("no server answers: {error}")))?;
        let (from, to) = stream.into_split();
        let mut from = BufReader::with_capacity(AT_ONCE * Record::LEN, from);
        let lost = |error| self.error(format_args!("the server is gone: {error}"));
        let mut bytes = [0; Record::LEN];
        from.read_exact(&mut bytes).await.map_err(lost)?;
        match Record::decode(&bytes) {
            Some(Record::Hello { version: VERSION, .. }) => port.connected(),
            _ => {
                return Err(self.error(
                    "what answers there is no segment of this version: run the same version on both sides",
                ));
            }
        }
        let way = Way::new(to);
        let _left = port.leave(Box::new(Records::new(Arc::clone(&way))));
        let read = async {
            loop {
                from.read_exact(&mut bytes).await.map_err(lost)?;
                match Record::decode(&bytes) {
                    Some(record) => take(record, port),
                    None => port.malformed(),
                }
            }
        };
        tokio::select! {
            ended = read => ended,
            why = way.keep_open(port) => Err(self.error(format_args!("the server is gone: {why}"))),
        }
    }
}

fn take(record: Record, port: &Port) {
    match record {
        Record::Received { frame, at } => {
            let stamp = std::time::Duration::from_nanos(at.as_ticks());
            match Frame::try_from(frame) {
                Ok(cosmic) => port.received_at(&cosmic, stamp),
                Err(_) => port.foreign_at(&frame, stamp),
            }
        }
        Record::Sent { mailbox } => port.conclude(mailbox, Outcome::Sent),
        Record::Withdrawn { mailbox } => port.conclude(mailbox, Outcome::Withdrawn),
        Record::Lost { count } => port.lost(count),
        Record::Errors { transmit, receive } => port.errors(ErrorCounters { transmit, receive }),
        Record::BusOff => port.bus_off(),
        Record::Hello { .. } | Record::Load { .. } | Record::Withdraw { .. } => port.malformed(),
    }
}

impl Link for SegmentLink {
    async fn run(&mut self, port: &Port) -> LinkError {
        match self.carry(port).await {
            Ok(()) => self.error("ended"),
            Err(error) => error,
        }
    }
}

/// Records that are read at once, at most.
const AT_ONCE: usize = 64;
