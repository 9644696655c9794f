//! Nodes on a bus that one station keeps full, and a look at one of them.

use std::cell::Cell;
use std::path::PathBuf;
use std::rc::Rc;

use cosmic_bus::{Bus, EventKind, FaultModel, VirtualInstant};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_demo::example::EXAMPLE;
use cosmic_emu::{Cluster, NodeConfig, NodeId, Port, Station};

/// Images that are built together, and the variable of the environment that names their folder.
pub(crate) type Images = &'static str;
/// Of the example.
pub(crate) const VEHICLE: Images = "COSMIC_IMAGES";
/// Of the nodes whose size is a goal.
pub(crate) const SMALL: Images = "COSMIC_SMALL_IMAGES";

/// Nodes that have settled, and the one of them that is looked at.
pub(crate) struct Bed {
    pub(crate) cluster: Cluster,
    pub(crate) node: NodeId,
    /// Frames that the flood has sent.
    sent: Rc<Cell<u64>>,
}

/// What a node did in a second.
pub(crate) struct Second {
    /// Cycles in which its core did not sleep.
    pub(crate) awake: u64,
    /// Frames of the flood.
    pub(crate) frames: u64,
}

impl Bed {
    /// These nodes, on a bus that a station fills with frames of this identifier, if there is one.
    pub(crate) fn new(images: Images, nodes: &[&'static str], looked_at: &str, flood: Option<Id>) -> Self {
        let folder = std::env::var_os(images).unwrap_or_else(|| {
            panic!("{images} names no directory of images: run `cargo xtask bench --cycles`")
        });
        let folder = PathBuf::from(folder);
        let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()));
        let add = |name: &&'static str| cluster.add_node(NodeConfig::new(*name, folder.join(name))).unwrap();
        let ids: Vec<NodeId> = nodes.iter().map(add).collect();
        let node = ids[nodes.iter().position(|name| *name == looked_at).unwrap()];
        let sent = Rc::default();
        if let Some(id) = flood {
            let (starts_at, sent) = (Some(ms(SETTLED_MS - 200)), Rc::clone(&sent));
            cluster.add_station("flood", Box::new(Flood { id, starts_at, sequence: 0, sent }));
        }
        cluster.run_until(ms(SETTLED_MS));
        let _ = cluster.take_observations();
        Self { cluster, node, sent }
    }

    /// Lets a second pass.
    pub(crate) fn second(&mut self) -> Second {
        let (awake, frames) = (self.cluster.awake(self.node), self.sent.get());
        self.cluster.run_until(ms(SETTLED_MS + 1_000));
        Second { awake: self.cluster.awake(self.node) - awake, frames: self.sent.get() - frames }
    }
}

/// Keeps the three mailboxes of its controller full with frames of one identifier.
struct Flood {
    id: Id,
    starts_at: Option<VirtualInstant>,
    sequence: u64,
    sent: Rc<Cell<u64>>,
}

impl Flood {
    fn load(&mut self, mailbox: usize, port: &mut Port<'_>) {
        self.sequence += 1;
        // As contents of the suspension: a sequence number, travel and velocity.
        let payload = Payload::full((self.sequence << 32).to_be_bytes());
        assert!(port.load(mailbox, Frame::new(self.id, payload).into()));
    }
}

impl Station for Flood {
    fn acts_at(&self) -> Option<VirtualInstant> {
        self.starts_at
    }

    fn act(&mut self, port: &mut Port<'_>) {
        self.starts_at = None;
        (0..3).for_each(|mailbox| self.load(mailbox, port));
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        if let EventKind::Sent { mailbox } = event {
            self.sent.set(self.sent.get() + 1);
            self.load(*mailbox, port);
        }
    }
}

/// An identifier of the suspension, which the brake subscribes to.
pub(crate) fn suspension() -> Id {
    let channel = EXAMPLE.channels.iter().find(|channel| channel.name == "suspension").unwrap();
    Id::new(Priority::LEAST, channel.publisher, channel.etag)
}

/// An identifier of nobody in any plan. Its etag is one that brokers give, so that nodes that ask one for their etags know
/// only as they run that it is not theirs.
pub(crate) const FOREIGN: Id =
    Id::new(Priority::LEAST, TxNode::new(100).unwrap(), Etag::new(0x2A5A).unwrap());

/// Cycles of a core in a second.
pub(crate) const CORE_HERTZ: u64 = 168_000_000;

/// All have their clocks and names then.
const SETTLED_MS: u64 = 1_000;

pub(crate) fn ms(milliseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(milliseconds * 1_000_000)
}
