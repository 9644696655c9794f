//! Who speaks for a segment, if several gateways stand between it and the same network.
//!
//! The gateways of a segment see each other on its bus, whatever happens between them on IP: each publishes a *beacon* of
//! eight bytes, ten times a second. One leads, the others stand by. Who leads may forward for [`LEASE`] from the
//! publication of its last beacon that was sent; the others wait [`SILENCE`] from the last that they received, which is
//! longer, before one of them takes over. So there are never two, even if one was stopped for a while and goes on. Of
//! those that could, the one with the lowest TxNode takes over; who leads stays.
//!
//! A gateway forwards nothing that another gateway has published, of whatever network: an event goes from its origin to
//! each segment in one hop, and cannot go round.

use std::collections::HashMap;

use cosmic_core::can::TxNode;
use cosmic_core::event_layer::{Channel, SoftAttributes};
use cosmic_core::time::{Duration, Instant};

use crate::config::GATEWAYS;
use crate::keys::Name;

/// `[version, flags, group (2), zero (4)]`: bit 0 of the flags says that it leads, bit 1 that it could.
pub(crate) type Bytes = [u8; 8];

/// The channel of the beacons.
pub(crate) fn channel() -> Channel<Bytes> {
    let quality = SoftAttributes { deadline: Duration::from_millis(20), validity: Duration::from_millis(80) };
    Channel::soft(GATEWAYS, quality)
}

/// What a gateway says of itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Beacon {
    /// A hash of the network: gateways of different networks have nothing to do with each other.
    pub(crate) group: u16,
    pub(crate) leads: bool,
    pub(crate) able: bool,
}

impl Beacon {
    pub(crate) fn encode(self) -> Bytes {
        let [high, low] = self.group.to_be_bytes();
        [VERSION, u8::from(self.leads) | u8::from(self.able) << 1, high, low, 0, 0, 0, 0]
    }

    /// What a later version says more is ignored.
    pub(crate) fn decode(bytes: Bytes) -> Option<Self> {
        let [VERSION, flags, high, low, ..] = bytes else { return None };
        let group = u16::from_be_bytes([high, low]);
        Some(Self { group, leads: flags & 1 != 0, able: flags & 2 != 0 })
    }
}

/// The group of a network.
pub(crate) fn group_of(network: &Name) -> u16 {
    // FNV-1a, folded: the same in every build.
    let step = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    let hash = network.as_str().bytes().fold(0x811C_9DC5, step);
    (hash >> 16 ^ hash & 0xFFFF) as u16
}

#[derive(Clone, Copy, Debug)]
struct Other {
    heard_at: Instant,
    beacon: Beacon,
}

/// What a gateway knows of the others on a segment, and whether it leads.
#[derive(Debug)]
pub(crate) struct Leadership {
    group: u16,
    me: Option<TxNode>,
    /// It has listened for long enough from here on.
    listened_at: Instant,
    leads: bool,
    lease_until: Instant,
    /// A beacon was sent since it leads.
    confirmed: bool,
    others: HashMap<TxNode, Other>,
}

impl Leadership {
    pub(crate) fn new(group: u16) -> Self {
        let (listened_at, lease_until) = (Instant::FAR_FUTURE, Instant::EPOCH);
        Self {
            group,
            me: None,
            listened_at,
            leads: false,
            lease_until,
            confirmed: false,
            others: HashMap::new(),
        }
    }

    /// A beacon of another gateway has arrived. Returns whether it is of the one that leads for our network.
    pub(crate) fn on_beacon(&mut self, from: TxNode, beacon: Beacon, now: Instant) -> bool {
        let is_of_other = Some(from) != self.me;
        if is_of_other {
            self.others.insert(from, Other { heard_at: now, beacon });
        }
        is_of_other && beacon.leads && beacon.group == self.group
    }

    /// A beacon of ours has been sent, which was published then.
    pub(crate) fn on_sent(&mut self, published_at: Instant) {
        self.lease_until = self.lease_until.max(published_at + LEASE);
        self.confirmed = true;
    }

    /// To be called once a [`PERIOD`]. `me`: our TxNode, if we have one and the link stands. Returns the beacon to be
    /// published, if we can.
    pub(crate) fn tick(&mut self, me: Option<TxNode>, able: bool, now: Instant) -> Option<Beacon> {
        if me != self.me {
            (self.me, self.leads) = (me, false);
            self.listened_at = now + SILENCE;
        }
        self.others.retain(|_, other| now.saturating_since(other.heard_at) < MEMORY);
        let me = me?;
        let group = self.group;
        let alive =
            |other: &Other| other.beacon.group == group && now.saturating_since(other.heard_at) < SILENCE;
        let others: Vec<_> = self.others.iter().filter(|(_, other)| alive(other)).collect();
        let has_leader = others.iter().any(|(_, other)| other.beacon.leads);
        let before_us = |leads: bool| {
            others.iter().any(|(node, other)| {
                **node < me && if leads { other.beacon.leads } else { other.beacon.able }
            })
        };
        let was_leading = self.leads;
        self.leads = if was_leading {
            able && !before_us(true) && now < self.lease_until
        } else {
            able && now >= self.listened_at && !has_leader && !before_us(false)
        };
        if self.leads && !was_leading {
            // It may not forward yet, but has until then to get its first beacon sent.
            self.lease_until = now + LEASE;
            self.confirmed = false;
        } else if was_leading && !self.leads {
            // It was stopped, or cannot send: it begins anew, by listening.
            self.listened_at = now + SILENCE;
        }
        Some(Beacon { group, leads: self.leads, able })
    }

    /// We lead, as far as we know.
    pub(crate) const fn leads(&self) -> bool {
        self.leads
    }

    /// We may forward.
    pub(crate) fn may_forward(&self, now: Instant) -> bool {
        self.leads && self.confirmed && now < self.lease_until
    }

    /// Returns whether this node is another gateway.
    pub(crate) fn is_gateway(&self, node: TxNode) -> bool {
        self.others.contains_key(&node)
    }

    /// When the last beacon of a leader other than us arrived.
    pub(crate) fn leader_heard_at(&self) -> Option<Instant> {
        let of_leaders = |other: &&Other| other.beacon.group == self.group && other.beacon.leads;
        self.others.values().filter(of_leaders).map(|other| other.heard_at).max()
    }
}

/// Between two beacons.
pub(crate) const PERIOD: Duration = Duration::from_millis(100);
/// From the publication of a beacon that was sent: so long a leader may forward.
pub(crate) const LEASE: Duration = Duration::from_millis(400);
/// From the last beacon that was received: so long nobody else takes over.
pub(crate) const SILENCE: Duration = Duration::from_millis(600);
/// So long a node is known as a gateway.
const MEMORY: Duration = Duration::from_secs(5);
const VERSION: u8 = 1;

#[cfg(test)]
mod tests {
    use super::*;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(1_000 + milliseconds))
    }

    /// Gateways on one bus; each hears the others at once.
    struct Bus {
        gateways: Vec<(TxNode, Leadership, bool)>,
        now: u64,
    }

    impl Bus {
        fn new(nodes: &[u8]) -> Self {
            let gateway = |node: &u8| (TxNode::new(*node).unwrap(), Leadership::new(1), true);
            Self { gateways: nodes.iter().map(gateway).collect(), now: 0 }
        }

        /// One period, with some of them running.
        fn step(&mut self, running: &[usize]) {
            self.now += 100;
            let now = at(self.now);
            for one in running {
                let (node, leadership, able) = &mut self.gateways[*one];
                let (node, able) = (*node, *able);
                let Some(beacon) = leadership.tick(Some(node), able, now) else { continue };
                if beacon.leads {
                    leadership.on_sent(now);
                }
                for (_, other, _) in &mut self.gateways {
                    let _ = other.on_beacon(node, beacon, now);
                }
            }
            assert!(self.leaders().len() <= 1, "two lead at {}", self.now);
        }

        /// Who may forward now.
        fn leaders(&self) -> Vec<usize> {
            let may = |one: &usize| self.gateways[*one].1.may_forward(at(self.now));
            (0..self.gateways.len()).filter(may).collect()
        }
    }

    #[test]
    fn the_lowest_leads_and_stays() {
        let mut bus = Bus::new(&[9, 5, 7]);
        for _ in 0..8 {
            bus.step(&[0, 2]);
        }
        assert_eq!(bus.leaders(), [2], "7 is lower than 9");
        for _ in 0..20 {
            bus.step(&[0, 1, 2]);
        }
        assert_eq!(bus.leaders(), [2], "5 came later, and waits");
        for _ in 0..8 {
            bus.step(&[0, 1]);
        }
        assert_eq!(bus.leaders(), [1], "7 is gone");
    }

    #[test]
    fn another_takes_over_within_a_second_and_one_that_was_stopped_does_not_go_on() {
        let mut bus = Bus::new(&[5, 7]);
        for _ in 0..10 {
            bus.step(&[0, 1]);
        }
        assert_eq!(bus.leaders(), [0]);
        let stopped = bus.now;
        while bus.leaders() != [1] {
            bus.step(&[1]);
            assert!(bus.now - stopped < 1000);
        }
        // 5 goes on: it still believes to lead, but its lease is over before it has read anything.
        assert!(bus.gateways[0].1.leads() && !bus.gateways[0].1.may_forward(at(bus.now)));
        for _ in 0..20 {
            bus.step(&[1, 0]);
        }
        assert_eq!(bus.leaders(), [1], "who leads stays");
    }

    #[test]
    fn one_that_is_not_able_gives_way() {
        let mut bus = Bus::new(&[5, 7]);
        for _ in 0..10 {
            bus.step(&[0, 1]);
        }
        bus.gateways[0].2 = false;
        for _ in 0..3 {
            bus.step(&[0, 1]);
        }
        assert_eq!(bus.leaders(), [1]);
    }

    #[test]
    fn beacons_have_their_bytes_and_other_networks_do_not_count() {
        let beacon = Beacon { group: 0xABCD, leads: true, able: true };
        assert_eq!(beacon.encode(), [1, 3, 0xAB, 0xCD, 0, 0, 0, 0]);
        assert_eq!(Beacon::decode(beacon.encode()), Some(beacon));
        assert_eq!(Beacon::decode([2; 8]), None);
        let mut leadership = Leadership::new(1);
        let (me, other) = (TxNode::new(9).unwrap(), TxNode::new(5).unwrap());
        let _ = leadership.tick(Some(me), true, at(0));
        for now in (100..1000).step_by(100) {
            let of_ours = leadership.on_beacon(other, Beacon { group: 2, leads: true, able: true }, at(now));
            assert!(!of_ours, "it forwards nothing of ours");
            let _ = leadership.tick(Some(me), true, at(now));
        }
        assert!(leadership.leads() && leadership.is_gateway(other));
        let _ = leadership.tick(Some(me), true, at(6000));
        assert!(!leadership.is_gateway(other), "forgotten");
        let names = ["plant", "plant2"].map(|name| group_of(&Name::new(name).unwrap()));
        assert_ne!(names[0], names[1]);
    }
}
