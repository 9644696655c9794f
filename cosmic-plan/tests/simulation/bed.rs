//! Nodes with one mailbox for each class on the bit-accurate bus: the rules of the middleware, written
//! down once more and as plainly as can be.

use cosmic_bus::{Bus, EventKind, FaultModel, StationId, WireFrame};
use cosmic_core::can::BitRate;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use std::collections::BTreeMap;

/// How a frame gets its identifier.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Naming {
    /// It has one.
    Fixed { extended: bool, id: u32 },
    /// By its deadline: the identifier's lower 21 bits stand here.
    Soft { tail: u32, deadline: u64 },
}

/// A source of frames.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) node: usize,
    pub(crate) mailbox: usize,
    pub(crate) naming: Naming,
    pub(crate) bytes: usize,
    /// (nominal instant, instant of publication), in order.
    pub(crate) releases: Vec<(u64, u64)>,
    /// How many frames one release brings, each queued when the one before has gone.
    pub(crate) frames: u32,
}

/// The longest latencies seen of a source, from nominal instant and from publication until sent.
#[derive(Clone, Copy, Default, PartialEq, Debug)]
pub(crate) struct Seen {
    pub(crate) count: u32,
    pub(crate) from_nominal: u64,
    pub(crate) from_publication: u64,
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    source: usize,
    nominal: u64,
    published: u64,
    frames_left: u32,
}

#[derive(Default)]
struct Lane {
    queue: Vec<Pending>,
    loaded: Option<(Pending, u8)>,
}

pub(crate) struct Bed {
    bus: Bus,
    stations: Vec<StationId>,
    lanes: BTreeMap<(usize, usize), Lane>,
    sources: Vec<Source>,
    step: u64,
    seen: Vec<Seen>,
}

/// Half of the bits are stuffable runs: close to the longest frame of a length.
const STUFFED: [u8; 8] = [0x0F, 0x0F, 0x0F, 0x0F, 0x0F, 0x0F, 0x0F, 0x0F];

fn instant(ticks: u64) -> cosmic_bus::time::VirtualInstant {
    cosmic_bus::time::VirtualInstant::from_ticks(ticks)
}

impl Bed {
    /// A bus with these sources; `step` is Δt_p.
    pub(crate) fn new(rate: BitRate, faults: FaultModel, sources: Vec<Source>, step: u64) -> Self {
        let mut bus = Bus::new(rate, faults);
        let nodes = sources.iter().map(|s| s.node).max().unwrap_or(0) + 1;
        let stations = (0..nodes.max(2)).map(|n| bus.attach(format!("n{n}"))).collect();
        let seen = vec![Seen::default(); sources.len()];
        Self { bus, stations, lanes: BTreeMap::new(), sources, step, seen }
    }

    /// Runs until all frames released before `end` have gone, or at most as long again.
    pub(crate) fn run(mut self, end: u64) -> Vec<Seen> {
        let mut releases: Vec<(u64, u64, usize)> = Vec::new();
        for (at, source) in self.sources.iter().enumerate() {
            releases.extend(source.releases.iter().map(|&(nominal, published)| (published, nominal, at)));
        }
        releases.sort_unstable();
        releases.retain(|release| release.0 < end);
        let mut next = 0;
        let mut events = Vec::new();
        loop {
            let release = releases.get(next).map(|release| release.0);
            let bus = self.bus.next_event().map(|at| at.as_ticks());
            let Some(now) = release.into_iter().chain(bus).chain(self.next_promotion()).min() else { break };
            if now > 2 * end {
                break;
            }
            self.bus.advance(instant(now), &mut events);
            self.handle(&mut events, now);
            while let Some(&(published, nominal, source)) = releases.get(next).filter(|r| r.0 <= now) {
                next += 1;
                self.publish(Pending {
                    source,
                    nominal,
                    published,
                    frames_left: self.sources[source].frames,
                });
            }
            self.promote(now);
            self.refill(now);
        }
        self.seen
    }

    fn publish(&mut self, pending: Pending) {
        let source = &self.sources[pending.source];
        self.lanes.entry((source.node, source.mailbox)).or_default().queue.push(pending);
    }

    fn handle(&mut self, events: &mut Vec<cosmic_bus::Event>, now: u64) {
        for event in events.drain(..) {
            let node = event.station.index();
            match event.kind {
                EventKind::Sent { mailbox } => {
                    let lane = self.lanes.get_mut(&(node, mailbox)).expect("it was loaded");
                    let (mut pending, _) = lane.loaded.take().expect("it was loaded");
                    pending.frames_left -= 1;
                    if pending.frames_left > 0 {
                        lane.queue.push(pending);
                        continue;
                    }
                    let seen = &mut self.seen[pending.source];
                    seen.count += 1;
                    seen.from_nominal = seen.from_nominal.max(event.at.as_ticks() - pending.nominal);
                    seen.from_publication =
                        seen.from_publication.max(event.at.as_ticks() - pending.published);
                }
                EventKind::Withdrawn { mailbox } => {
                    let lane = self.lanes.get_mut(&(node, mailbox)).expect("it was loaded");
                    if let Some((pending, _)) = lane.loaded.take() {
                        lane.queue.push(pending);
                    }
                }
                _ => {}
            }
        }
        self.refill(now);
    }

    /// By which order a lane sends: deadline, then first in first out; or priority of the identifier.
    fn rank(&self, pending: &Pending) -> (u64, u64) {
        match self.sources[pending.source].naming {
            Naming::Soft { deadline, .. } => (pending.published + deadline, pending.published),
            Naming::Fixed { id, .. } => (u64::from(id), pending.published),
        }
    }

    fn priority(&self, pending: &Pending, now: u64) -> u8 {
        match self.sources[pending.source].naming {
            Naming::Soft { deadline, .. } => {
                let left = (pending.published + deadline).saturating_sub(now) / self.step;
                u8::try_from(left.saturating_add(1).min(249)).unwrap_or(249)
            }
            Naming::Fixed { .. } => 0,
        }
    }

    fn next_promotion(&self) -> Option<u64> {
        self.lanes.values().filter_map(|lane| self.promotion(lane)).min()
    }

    fn promotion(&self, lane: &Lane) -> Option<u64> {
        let (pending, priority) = lane.loaded?;
        let Naming::Soft { deadline, .. } = self.sources[pending.source].naming else { return None };
        let ahead = (u64::from(priority).checked_sub(1)?) * self.step;
        (ahead > 0).then(|| (pending.published + deadline + 1).saturating_sub(ahead))
    }

    /// Withdraws what has a new priority, or stands behind something that came later.
    fn promote(&mut self, now: u64) {
        let outdated: Vec<(usize, usize)> = self
            .lanes
            .iter()
            .filter(|(_, lane)| {
                let Some((pending, _)) = lane.loaded else { return false };
                let overtaken = lane.queue.iter().any(|other| self.rank(other).0 < self.rank(&pending).0);
                overtaken || self.promotion(lane).is_some_and(|at| at <= now)
            })
            .map(|(key, _)| *key)
            .collect();
        for (node, mailbox) in outdated {
            let mut events = Vec::new();
            self.bus.withdraw(instant(now), self.stations[node], mailbox);
            self.bus.advance(instant(now), &mut events);
            // A frame that is on the wire goes on with its old priority; do not ask again.
            if let Some(lane) = self.lanes.get_mut(&(node, mailbox))
                && let Some((_, priority)) = &mut lane.loaded
            {
                *priority = 0;
            }
            self.handle(&mut events, now);
        }
    }

    fn refill(&mut self, now: u64) {
        let free: Vec<(usize, usize)> = self
            .lanes
            .iter()
            .filter(|(_, lane)| lane.loaded.is_none() && !lane.queue.is_empty())
            .map(|(key, _)| *key)
            .collect();
        for (node, mailbox) in free {
            let lane = &self.lanes[&(node, mailbox)];
            let first =
                (0..lane.queue.len()).min_by_key(|at| self.rank(&lane.queue[*at])).expect("not empty");
            let pending = self.lanes.get_mut(&(node, mailbox)).expect("it is there").queue.remove(first);
            let priority = self.priority(&pending, now);
            let source = &self.sources[pending.source];
            let id: Id = match source.naming {
                Naming::Fixed { extended: false, id } => StandardId::new(id as u16).expect("11 bits").into(),
                Naming::Fixed { extended: true, id } => ExtendedId::new(id).expect("29 bits").into(),
                Naming::Soft { tail, .. } => {
                    ExtendedId::new(u32::from(priority) << 21 | tail).expect("29 bits").into()
                }
            };
            let frame = WireFrame::new(id, &STUFFED[..source.bytes]).expect("at most 8 bytes");
            self.bus.load(instant(now), self.stations[node], mailbox, frame).expect("the mailbox is free");
            self.lanes.get_mut(&(node, mailbox)).expect("it is there").loaded = Some((pending, priority));
        }
    }
}
