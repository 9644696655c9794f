//! The writing end of the link to a segment: a record is written by whoever makes its frame due.

use std::io;
use std::sync::{Arc, OnceLock};

use cosmic_bus::WireFrame;
use tokio::net::unix::OwnedWriteHalf;
use tokio::sync::Notify;

use super::Record;
use crate::link::Port;
use crate::link::bell::Outgoing;
use crate::places::Handover;

/// What the writing end and the link's task share.
pub(super) struct Way {
    to: OwnedWriteHalf,
    /// The socket has no room, or is broken.
    stuck: Notify,
    broken: OnceLock<io::Error>,
}

impl Way {
    pub(super) fn new(to: OwnedWriteHalf) -> Arc<Self> {
        Arc::new(Self { to, stuck: Notify::new(), broken: OnceLock::new() })
    }

    /// Has what was left over written whenever there is room again. Returns why nothing can be written any more.
    pub(super) async fn keep_open(&self, port: &Port) -> String {
        loop {
            self.stuck.notified().await;
            if let Err(error) = self.to.writable().await {
                return error.to_string();
            }
            port.ring();
            if let Some(error) = self.broken.get() {
                return error.to_string();
            }
        }
    }
}

/// Writes records.
pub(super) struct Records {
    way: Arc<Way>,
    /// Bytes that found no room: less than one record for each mailbox and what can be done with it.
    left: Vec<u8>,
}

impl Records {
    pub(super) const fn new(way: Arc<Way>) -> Self {
        Self { way, left: Vec::new() }
    }

    /// Returns whether nothing is left over.
    fn write(&mut self) -> bool {
        while !self.left.is_empty() {
            match self.way.to.try_write(&self.left) {
                Ok(written) => drop(self.left.drain(..written)),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    if error.kind() != io::ErrorKind::WouldBlock {
                        // The first one says why.
                        let _ = self.way.broken.set(error);
                    }
                    self.way.stuck.notify_one();
                    return false;
                }
            }
        }
        true
    }
}

impl Outgoing for Records {
    fn send(&mut self, due: &mut dyn FnMut() -> Option<Handover>) {
        // What finds no room stays with the node, where it can still be withdrawn.
        if !self.write() {
            return;
        }
        while let Some(handover) = due() {
            let record = match handover {
                Handover::Send(mailbox, frame) => Record::Load { mailbox, frame: WireFrame::from(frame) },
                Handover::Withdraw(mailbox) => Record::Withdraw { mailbox },
            };
            self.left.extend(record.encode());
        }
        self.write();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
    use tokio::io::AsyncReadExt as _;
    use tokio::net::UnixStream;

    #[tokio::test]
    async fn what_finds_no_room_stays_with_the_node() {
        let (here, mut there) = UnixStream::pair().unwrap();
        let way = Way::new(here.into_split().1);
        way.to.writable().await.unwrap();
        let mut in_the_way = 0;
        while let Ok(written) = way.to.try_write(&[0; 1001]) {
            in_the_way += written;
        }
        let frame = Frame::new(Id::new(Priority::LEAST, TxNode::MIN, Etag::BOUND_LAST), Payload::EMPTY);
        let mut due = vec![Handover::Withdraw(Mailbox::Soft), Handover::Send(Mailbox::NonRealTime, frame)];
        let mut records = Records::new(Arc::clone(&way));
        // What it has taken it keeps; no more is taken before that has left.
        records.send(&mut || due.pop());
        assert_eq!(due, []);
        due.push(Handover::Withdraw(Mailbox::NonRealTime));
        records.send(&mut || due.pop());
        assert_eq!(due.len(), 1);
        way.stuck.notified().await;
        there.read_exact(&mut vec![0; in_the_way]).await.unwrap();
        way.to.writable().await.unwrap();
        records.send(&mut || due.pop());
        assert_eq!(due, []);
        let mut bytes = [0; 3 * Record::LEN];
        there.read_exact(&mut bytes).await.unwrap();
        let read = bytes.chunks_exact(Record::LEN).map(|bytes| Record::decode(bytes.try_into().unwrap()));
        let expected = [
            Record::Load { mailbox: Mailbox::NonRealTime, frame: WireFrame::from(frame) },
            Record::Withdraw { mailbox: Mailbox::Soft },
            Record::Withdraw { mailbox: Mailbox::NonRealTime },
        ];
        assert_eq!(read.collect::<Option<Vec<_>>>().unwrap(), expected);
        assert!(way.broken.get().is_none());
        drop(there);
        due.push(Handover::Withdraw(Mailbox::Soft));
        records.send(&mut || due.pop());
        assert!(way.broken.get().is_some());
    }
}
