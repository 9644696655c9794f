//! FAMOUSO's broker and client, as far as they show on the bus, and clusters of both kinds of nodes.
//!
//! Neither has time-outs. The broker expects one stage after the other, drops every request of another
//! stage, and answers with the request's own identifier in which it replaces etag and TxNode; it hands out
//! ids from 126 down and etags from 16383 down. The client waits for an answer for ever; a prefix other
//! than its own keeps it waiting, the end of any search or eight zero bytes make it begin again.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use cosmic_core::broker::*;
use cosmic_core::can::{Etag, Frame, Id, Payload, TxNode};
use cosmic_core::client::*;
use cosmic_core::protocol::Output;
use cosmic_core::time::{Duration, Instant};

use crate::ether::*;

const SECOND: Duration = Duration::from_secs(1);
const BIT_21: u32 = 1 << 21;

fn raw_frame(id: u32, data: &[u8]) -> Frame {
    Frame::new(Id::from_raw(id).unwrap(), Payload::new(data).unwrap())
}

struct OldBroker {
    stage: u32,
    bits: u64,
    nodes: Vec<u64>,
    subjects: Vec<u64>,
    outbox: VecDeque<Frame>,
}

impl OldBroker {
    fn new() -> Self {
        Self { stage: 15, bits: 0, nodes: Vec::new(), subjects: Vec::new(), outbox: VecDeque::new() }
    }

    fn index_in(table: &mut Vec<u64>, name: u64) -> u32 {
        let known = table.iter().position(|entry| *entry == name);
        known.unwrap_or_else(|| {
            table.push(name);
            table.len() - 1
        }) as u32
    }

    fn on_request(&mut self, id: u32) {
        let (stage, nibble) = (id >> 18 & 0xF, u64::from(id >> 14 & 0xF));
        if stage != self.stage {
            return;
        }
        self.bits |= nibble << (4 * stage);
        let tx_node = if stage == 0 { 126 - Self::index_in(&mut self.nodes, self.bits) } else { 0x7F };
        let data = (self.bits | u64::from(stage)).to_be_bytes();
        self.outbox.push_back(raw_frame(0x7D << 22 | id & BIT_21 | tx_node << 14, &data));
        if stage == 0 {
            (self.stage, self.bits) = (15, 0);
        } else {
            self.stage -= 1;
        }
    }

    fn on_get_etag(&mut self, id: u32, data: [u8; 8]) {
        let etag = 0x3FFF - Self::index_in(&mut self.subjects, u64::from_be_bytes(data));
        for half in 0..2 {
            let mut reply = [(id >> 14 & 0x7F) as u8, half as u8, (etag >> 8) as u8, etag as u8, 0, 0, 0, 0];
            reply[4..].copy_from_slice(&data[4 * half..4 * half + 4]);
            self.outbox.push_back(raw_frame(0x7D << 22 | id & BIT_21 | 0x7F << 14 | 4, &reply));
        }
    }
}

impl Station for OldBroker {
    fn on_frame(&mut self, frame: &Frame, _: Instant) {
        match frame.id.etag().get() {
            1 => self.on_request(frame.id.raw()),
            2 => self.on_get_etag(frame.id.raw(), frame.payload.padded()),
            _ => {}
        }
    }

    fn poll(&mut self, _: Instant, outbox: &mut VecDeque<Frame>) {
        outbox.append(&mut self.outbox);
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }
}

struct OldClient {
    uid: u64,
    stage: u32,
    tx_node: Option<u8>,
    subject: u64,
    etag: Option<u16>,
    /// How many halves of the answer have been heard.
    halves: usize,
    outbox: VecDeque<Frame>,
}

impl OldClient {
    fn new(uid: u64, subject: u64) -> Self {
        let mut new =
            Self { uid, stage: 15, tx_node: None, subject, etag: None, halves: 0, outbox: VecDeque::new() };
        new.ask(15);
        new
    }

    fn ask(&mut self, stage: u32) {
        self.stage = stage;
        let nibble = (self.uid >> (4 * stage)) as u32 & 0xF;
        self.outbox.push_back(raw_frame(0x7D << 22 | stage << 18 | nibble << 14 | 1, &[]));
    }

    fn on_reply(&mut self, tx_node: u8, bits: u64) {
        if tx_node == 0x7F && bits == 0 {
            self.ask(15);
        } else if tx_node == 0x7F {
            let same_prefix = (bits ^ self.uid) >> (4 * self.stage) == 0;
            if u64::from(self.stage) == bits & 0xF && same_prefix {
                self.ask(self.stage - 1);
            }
        } else if bits == self.uid {
            self.tx_node = Some(tx_node);
            let id = 0x7D << 22 | u32::from(tx_node) << 14 | 2;
            self.outbox.push_back(raw_frame(id, &self.subject.to_be_bytes()));
        } else {
            self.ask(15);
        }
    }

    fn on_supply(&mut self, data: [u8; 8]) {
        let index = usize::from(data[1].wrapping_shl(2));
        if self.etag.is_some() || index != 4 * self.halves {
            return;
        }
        if self.subject.to_be_bytes()[index..index + 4] != data[4..] {
            self.halves = 0;
            return;
        }
        self.halves += 1;
        if self.halves == 2 {
            self.etag = Some(u16::from(data[2] & 0x3F) << 8 | u16::from(data[3]));
        }
    }
}

impl Station for OldClient {
    fn on_frame(&mut self, frame: &Frame, _: Instant) {
        match (frame.id.etag().get(), self.tx_node) {
            (0, None) => self.on_reply(frame.id.tx_node().get(), u64::from_be_bytes(frame.payload.padded())),
            (4, Some(_)) => self.on_supply(frame.payload.padded()),
            _ => {}
        }
    }

    fn poll(&mut self, _: Instant, outbox: &mut VecDeque<Frame>) {
        outbox.append(&mut self.outbox);
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }

    fn old_names(&self) -> Option<(Option<u8>, Option<u16>)> {
        Some((self.tx_node, self.etag))
    }
}

/// The ids of all nodes of both kinds, and the etags of each subject.
type Names = (Vec<u8>, BTreeMap<u64, BTreeSet<u16>>);

/// `None` until all have theirs.
fn all_names(ether: &Ether, subject_of_old: u64) -> Option<Names> {
    let (mut ids, mut etags) = (Vec::new(), BTreeMap::<_, BTreeSet<_>>::new());
    for node in ether.nodes() {
        ids.push(node.tx_node()?.get());
        for subject in node.subjects() {
            etags.entry(subject).or_default().insert(node.etag_of(subject)?.get());
        }
    }
    for (id, etag) in ether.old_names() {
        ids.push(id?);
        etags.entry(subject_of_old).or_default().insert(etag?);
    }
    Some((ids, etags))
}

fn assert_unique(ether: &Ether, subject_of_old: u64) {
    let (ids, etags) = all_names(ether, subject_of_old).expect("all have their names");
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len(), "{ids:?}");
    let used: Vec<u16> = etags.values().flatten().copied().collect();
    assert!(etags.values().all(|etags| etags.len() == 1), "{etags:?}");
    assert_eq!(used.iter().collect::<BTreeSet<_>>().len(), used.len(), "{etags:?}");
}

/// A claim comes between the two halves of an old client's answer. It neither takes the claimed etag nor
/// waits for ever.
#[test]
fn a_claim_does_not_confuse_an_old_client() {
    let now = Instant::EPOCH;
    for first_half_of_claim in ["1F4A8004#2A043FF011223344", "1F4A8004#2A043FF000000000"] {
        let mut old = OldClient { tx_node: Some(0x7E), ..OldClient::new(1, 0x1122_3344_5566_7788) };
        for frame in [
            "1F5FC004#7E003FFE11223344", // the answer
            first_half_of_claim,
            "1F4A8004#2A053FF055667788",
            "1F5FC004#7E013FFE55667788",
        ] {
            old.on_frame(&from_candump(frame), now);
        }
        assert_eq!(old.etag, Some(0x3FFE), "{first_half_of_claim}");
    }
    // These are the claims that a node of ours sends.
    let mut node = Binding::<1>::new(0, &BindingTiming::DEFAULT);
    node.assume(subject(0x1122_3344_5566_7788), Etag::new(0x3FF0).unwrap()).unwrap();
    node.set_tx_node(Some(tx_node(0x2A)));
    node.on_frame(&from_candump("1F404008#"), now);
    let claim = ["1F4A8004#2A043FF011223344", "1F4A8004#2A053FF055667788"].map(from_candump);
    assert_eq!(core::iter::from_fn(|| node.poll(now)).collect::<Vec<_>>(), claim.map(Output::Send));
}

#[test]
fn the_old_broker_serves_nodes_of_both_kinds() {
    for seed in 0..10 {
        let mut ether = Ether::new(seed);
        ether.add(OldBroker::new());
        for at in 0..6 {
            ether.add(
                Node::asking(ether.now, 0x4020_0000_0000_0000 + at, seed ^ at).with_subjects([1, 2 + at]),
            );
            ether.add(OldClient::new(0x4010_0000_0000_0000 + at, 1));
        }
        ether.run_until(SECOND * 10, |ether| all_names(ether, 1).is_some());
        assert_unique(&ether, 1);
    }
}

#[test]
fn our_broker_serves_nodes_of_both_kinds() {
    for seed in 0..10 {
        let mut ether = Ether::new(seed);
        ether.add(Node::fixed(ether.now, 0xB0, 1, seed).hosting(Nodes::new(), Subjects::new()));
        // The old clients wait for ever, so they are there when the broker begins: it starts with a
        // restart, which they understand.
        for at in 0..6 {
            ether.add(OldClient::new(0x4010_0000_0000_0000 + at, 1));
            ether.add(
                Node::asking(ether.now, 0x4020_0000_0000_0000 + at, seed ^ at).with_subjects([1, 2 + at]),
            );
        }
        ether.run_until(SECOND * 10, |ether| all_names(ether, 1).is_some());
        assert_unique(&ether, 1);
    }
}

#[test]
fn an_old_client_that_dies_does_not_block_the_others() {
    let mut ether = Ether::new(1);
    ether.add(Node::fixed(ether.now, 0xB0, 1, 1).hosting(Nodes::new(), Subjects::new()));
    ether.run_until(SECOND, |ether| ether.node(0).role() == BrokerRole::Active);
    ether.run(Duration::from_millis(10));
    let dying = ether.add(OldClient::new(0x1000_0000_0000_0000, 1));
    ether.add(OldClient::new(0x2000_0000_0000_0000, 1));
    ether.log.clear();
    ether.run_until(SECOND, |ether| ether.log.len() >= 9);
    ether.kill(dying);
    ether.run_until(SECOND * 2, |ether| all_names(ether, 1).is_some());
}

#[test]
fn a_standby_takes_over_from_the_old_broker_when_that_no_longer_answers() {
    let mut ether = Ether::new(2);
    let old = ether.add(OldBroker::new());
    ether.add(Node::asking(ether.now, 0x10, 1).with_subjects([1]));
    ether.run_until(SECOND, |ether| all_names(ether, 1).is_some());
    let standby = ether.add(Node::fixed(ether.now, 0xB0, 1, 2).hosting(Nodes::new(), Subjects::new()));
    // It hears the old broker serve a node while it listens.
    ether.add(Node::asking(ether.now, 0x11, 3).with_subjects([1, 2]));
    ether.run(SECOND * 10);
    assert_eq!(ether.node(standby).role(), BrokerRole::Standby, "nobody asks, so nobody is missed");
    ether.kill(old);
    ether.run(SECOND * 10);
    assert_eq!(ether.node(standby).role(), BrokerRole::Standby);
    ether.add(Node::asking(ether.now, 0x12, 4).with_subjects([1, 2, 3]));
    ether.run_until(SECOND * 5, |ether| all_names(ether, 1).is_some());
    assert_eq!(ether.node(standby).role(), BrokerRole::Active);
    assert_unique(&ether, 1);
}

/// The old broker has served a node, and nobody asks it any more when ours starts.
#[test]
fn our_broker_stands_by_beside_a_quiet_old_one() {
    for seed in 0..10 {
        let mut ether = Ether::new(seed);
        ether.add(OldBroker::new());
        ether.add(OldClient::new(0x4010_0000_0000_0000, 1));
        ether.add(Node::asking(ether.now, 0x10, seed).with_subjects([2]));
        ether.run_until(SECOND, |ether| all_names(ether, 1).is_some());
        ether.run(SECOND * 5);
        let ours = ether.add(Node::fixed(ether.now, 0xB0, 1, seed).hosting(Nodes::new(), Subjects::new()));
        ether.run(SECOND * 5);
        assert_eq!(ether.node(ours).role(), BrokerRole::Standby);
        assert!(ether.node(ours).broker_events.contains(&BrokerEvent::ForeignBroker));
        // The old one dies. What it gave to its old client, which says nothing, is not given again.
        ether.kill(0);
        ether.add(Node::asking(ether.now, 0x11, seed).with_subjects([2, 3, 4]));
        ether.run_until(SECOND * 5, |ether| all_names(ether, 1).is_some());
        assert_eq!(ether.node(ours).role(), BrokerRole::Active);
        assert_unique(&ether, 1);
    }
}

#[test]
fn a_standby_knows_the_ids_of_old_clients() {
    let mut ether = Ether::new(4);
    ether.add(Node::fixed(ether.now, 0xB0, 1, 1).hosting(Nodes::new(), Subjects::new()));
    let standby = ether.add(Node::fixed(ether.now, 0xB1, 2, 1).hosting(Nodes::new(), Subjects::new()));
    ether.run_until(SECOND * 2, |ether| ether.node(standby).role() == BrokerRole::Standby);
    ether.add(OldClient::new(0x1234, 1));
    ether.run_until(SECOND, |ether| all_names(ether, 1).is_some());
    let mirror = ether.node(standby).broker.as_ref().unwrap();
    let (id, etag) = ether.old_names().next().unwrap();
    assert_eq!(mirror.nodes().uid_of(tx_node(id.unwrap())), Some(uid(0x1234)));
    assert_eq!(mirror.subjects().etag_of(subject(1)).map(Etag::get), etag);
}

#[test]
fn an_old_client_that_gets_no_id_does_not_block_the_others() {
    let mut ether = Ether::new(3);
    ether.add(Node::fixed(ether.now, 0xB0, 1, 1).hosting(Nodes::new(), Subjects::new()));
    for at in 0..20 {
        ether.add(Node::asking(ether.now, 0x2000 + at, at));
    }
    ether.run_until(SECOND * 10, |ether| ether.nodes().all(|node| node.tx_node().is_some()));
    // The smallest UID wins every search, and is refused.
    let refused = ether.add(OldClient::new(0x1000, 1));
    ether.run(SECOND);
    ether.replace(5, Node::asking(ether.now, 0x2004, 1));
    ether.run_until(SECOND * 5, |ether| ether.node(5).tx_node().is_some());
    ether.log.clear();
    ether.run(SECOND * 10);
    assert_eq!(ether.old_names().next(), Some((None, None)));
    let requests = ether.log.iter().filter(|frame| frame.id.etag() == Etag::CONFIGURATION_REQUEST).count();
    assert!(requests <= 16 * 11, "it asks once a second: {requests}");
    ether.kill(refused);
    assert!(ether.nodes().all(|node| node.tx_node() != Some(TxNode::BROKER)));
}
