//! A segment without a bus: the link of a gateway ends here, and a frame takes no time but that of the link.
//!
//! It speaks as the server of a simulated segment does, over a Unix socket, and acknowledges each frame at once. Threads
//! of its own read and write, so that what is measured is the other side.

use std::io::{BufReader, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration as Span;

use cosmic_bus::{VirtualInstant, WireFrame};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_gateway::clock::Reading;
use cosmic_linux::link::segment::{Record, VERSION};

use crate::failed::Failed;

/// What is done with a frame of the other side, and when it was read.
type Hear = dyn Fn(&Frame, Reading) + Send + Sync;

/// A segment without a bus.
pub struct Wire {
    path: PathBuf,
    end: Arc<End>,
}

#[derive(Default)]
struct End {
    /// Who is connected: one at a time.
    stream: Mutex<Option<UnixStream>>,
    connected: Condvar,
}

impl End {
    fn lock(&self) -> MutexGuard<'_, Option<UnixStream>> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, record: &Record) -> bool {
        self.lock().as_mut().is_some_and(|stream| stream.write_all(&record.encode()).is_ok())
    }
}

impl Wire {
    /// Serves it at a path.
    ///
    /// # Errors
    /// The socket cannot be made.
    pub fn serve(
        path: &Path,
        hear: impl Fn(&Frame, Reading) + Send + Sync + 'static,
    ) -> Result<Self, Failed> {
        let listener = UnixListener::bind(path).map_err(Failed::at(path.display()))?;
        let end = Arc::new(End::default());
        let (of_thread, hear): (_, Arc<Hear>) = (Arc::clone(&end), Arc::new(hear));
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let (end, hear) = (Arc::clone(&of_thread), Arc::clone(&hear));
                std::thread::spawn(move || carry(stream, &end, &*hear));
            }
        });
        Ok(Self { path: path.to_owned(), end })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Waits until somebody is connected.
    ///
    /// # Errors
    /// Nobody comes.
    pub fn connected(&self, patience: Span) -> Result<(), Failed> {
        let stream = self.end.lock();
        let waited = self.end.connected.wait_timeout_while(stream, patience, |stream| stream.is_none());
        let (stream, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let name = self.path.display();
        if stream.is_some() { Ok(()) } else { Err(Failed(format!("nobody connects to {name}"))) }
    }

    /// An event of a node of the segment. Waits while the other side does not read. Returns whether it was written.
    pub fn say(&self, etag: Etag, content: u64) -> bool {
        let id = Id::new(Priority::SOFT_LEAST_URGENT, PUBLISHER, etag);
        let frame = Frame::new(id, Payload::full(content.to_be_bytes()));
        let at = VirtualInstant::from_ticks(Reading::now().0);
        self.end.write(&Record::Received { frame: WireFrame::from(frame), at })
    }
}

/// Until the other side is gone.
fn carry(stream: UnixStream, end: &End, hear: &Hear) {
    let Ok(other) = stream.try_clone() else { return };
    *end.lock() = Some(other);
    if !end.write(&Record::Hello { version: VERSION, bits_per_second: 1_000_000 }) {
        return;
    }
    end.connected.notify_all();
    let mut records = BufReader::new(stream);
    let mut bytes = [0; Record::LEN];
    while records.read_exact(&mut bytes).is_ok() {
        let at = Reading::now();
        // What was to be withdrawn is sent already.
        if let Some(Record::Load { mailbox, frame }) = Record::decode(&bytes) {
            end.write(&Record::Sent { mailbox });
            if let Ok(frame) = Frame::try_from(frame) {
                hear(&frame, at);
            }
        }
    }
    *end.lock() = None;
}

/// The eight bytes of an event, as [`Wire::say`] puts them.
pub fn content(frame: &Frame) -> u64 {
    u64::from_be_bytes(frame.payload.padded())
}

/// Who publishes on a wire.
const PUBLISHER: TxNode = TxNode::new(5).unwrap();
