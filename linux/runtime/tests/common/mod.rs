//! A simulated segment with nodes on it, and channels.
#![allow(dead_code, reason = "no test uses all of it")]

use std::path::{Path, PathBuf};

use cosmic_bus::{Bus, FaultModel, WireFrame};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, HardAttributes, Importance, NonRealTimeAttributes, SoftAttributes,
};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::segment::{Options, Record, SegmentLink, SimulatedSegment, serve};
use cosmic_linux::{Config, Node};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::UnixStream;
use tokio::sync::Mutex;
use tokio::task::JoinHandle;

pub(crate) const QUALITY: SoftAttributes =
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(20) };
pub(crate) const HEAT: Channel<i16> =
    Channel::soft(Subject::new(0x2A).unwrap(), QUALITY).with_etag(Etag::new(5000).unwrap());
pub(crate) const TEXT: Channel<u16> = Channel::non_real_time(
    Subject::new(0x2B).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::new(5001).unwrap());

const PERIOD: Duration = Duration::from_millis(10);
pub(crate) const SPEED: Channel<u16> = Channel::hard(
    Subject::new(0x2C).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);
pub(crate) static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    PERIOD,
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: TxNode::new(9).unwrap(),
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }],
);

pub(crate) fn speed_frame(number: u8) -> Frame {
    let id = Id::new(Priority::HARD, TxNode::new(9).unwrap(), Etag::HARD_FIRST);
    Frame::new(id, Payload::new(&[0, number]).unwrap())
}

pub(crate) fn uid(number: u64) -> NodeUid {
    NodeUid::new(number).unwrap()
}

pub(crate) fn depth(depth: u8) -> Depth {
    Depth::new(depth).unwrap()
}

pub(crate) struct Bed {
    folder: tempfile::TempDir,
    path: PathBuf,
    server: Mutex<Option<JoinHandle<()>>>,
}

impl Bed {
    pub(crate) async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segment");
        let bed = Self { folder, path, server: Mutex::new(None) };
        bed.restart().await;
        bed
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) async fn restart(&self) {
        let path = self.path.clone();
        *self.server.lock().await = Some(tokio::spawn(async move {
            let why = serve_at(&path).await;
            panic!("{why}");
        }));
        while UnixStream::connect(&self.path).await.is_err() {
            tokio::task::yield_now().await;
        }
    }

    pub(crate) async fn stop(&self) {
        if let Some(server) = self.server.lock().await.take() {
            server.abort();
            let _ = server.await;
        }
    }

    /// A node with this number, which is its TxNode.
    pub(crate) fn node(&self, number: u8) -> Node {
        self.start_node(Config::new(uid(number.into())).tx_node(TxNode::new(number).unwrap()))
    }

    pub(crate) fn start_node(&self, config: Config) -> Node {
        Node::start(config, SegmentLink::new(&self.path)).unwrap()
    }

    /// A station that is no node.
    pub(crate) async fn raw(&self) -> Raw {
        let mut raw = Raw(UnixStream::connect(&self.path).await.unwrap());
        assert!(matches!(raw.next().await, Record::Hello { .. }));
        raw
    }
}

/// Serves a simulated segment, and says why it ended.
pub(crate) async fn serve_at(path: &Path) -> String {
    let segment = SimulatedSegment::new(Bus::new(BitRate::MAX, FaultModel::none()));
    match serve(path, segment, Options { tokio_time: true }).await {
        Err(error) => error.to_string(),
    }
}

pub(crate) struct Raw(UnixStream);

impl Raw {
    pub(crate) async fn next(&mut self) -> Record {
        let mut bytes = [0; Record::LEN];
        self.0.read_exact(&mut bytes).await.unwrap();
        Record::decode(&bytes).unwrap()
    }

    /// Sends a frame, and waits until it was sent.
    pub(crate) async fn send(&mut self, frame: Frame) {
        let mailbox = Mailbox::Soft;
        self.send_bytes(&Record::Load { mailbox, frame: WireFrame::from(frame) }.encode()).await;
        while self.next().await != (Record::Sent { mailbox }) {}
    }

    pub(crate) async fn send_bytes(&mut self, bytes: &[u8]) {
        // A server that has hung up meanwhile shows in `closed`.
        let _ = self.0.write_all(bytes).await;
    }

    pub(crate) async fn closed(&mut self) {
        let mut bytes = [0; 64];
        while let Ok(1..) = self.0.read(&mut bytes).await {}
    }
}
