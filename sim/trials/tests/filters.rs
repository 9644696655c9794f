//! A node whose names a broker gives, on a full bus: its controller accepts what it subscribes to now.

use cosmic_bus::{EventKind, VirtualInstant};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_emu::{ObservationKind, Port, Station};
use cosmic_trials::{Trial, ms, on_board};

/// What the guest counts, by the only etag that the broker gives.
const COUNT: Etag = Etag::BOUND_LAST;
/// Of no channel here: it differs in one bit.
const FOREIGN: Id = Id::new(Priority::LEAST, TxNode::new(100).unwrap(), Etag::new(0x3FFE).unwrap());
/// The number of the interrupt of CAN2's FIFO 1 (RM0090, table 62), and 16.
const CAN2_RX1: u16 = 16 + 65;
const FLOOD_STARTS: u64 = 1_000;
const MASTER_GOES: u64 = 3_000;
/// The deputy names channels then.
const DEPUTY_NAMES: u64 = 4_000;
const END: u64 = 6_500;

/// Leaves the bus to nobody of less priority, and no room.
struct Flood(Option<VirtualInstant>);

impl Flood {
    fn load(mailbox: usize, port: &mut Port<'_>) {
        assert!(port.load(mailbox, Frame::new(FOREIGN, Payload::full([0x55; 8])).into()));
    }
}

impl Station for Flood {
    fn acts_at(&self) -> Option<VirtualInstant> {
        self.0
    }

    fn act(&mut self, port: &mut Port<'_>) {
        self.0 = None;
        (0..3).for_each(|mailbox| Self::load(mailbox, port));
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        if let EventKind::Sent { mailbox } = event {
            Self::load(*mailbox, port);
        }
    }
}

/// A span of time in which the hearer was subscribed, or not.
struct Phase {
    begins: u64,
    ends: u64,
    /// How many events it had, if it was.
    heard: Option<usize>,
}

/// All phases but the last, which may not have ended, each shorter by a turn at both ends.
fn phases(trial: &Trial) -> Vec<Phase> {
    let log = trial.log("hearer", 0);
    let lines: Vec<_> =
        log.iter().filter(|(_, line)| line.contains("hears") || line.contains("heard")).collect();
    let phase = |pair: &[&(u64, String)]| {
        let heard = pair[1].1.strip_prefix("INFO has heard ").map(|count| count.parse().unwrap());
        Phase { begins: pair[0].0 + 10, ends: pair[1].0 - 10, heard }
    };
    lines.windows(2).map(phase).collect()
}

#[test]
fn foreign_frames_do_not_interrupt_and_no_event_is_lost_whatever_changes() {
    let nodes = [("master", 0), ("deputy", 0), ("guest", 0), ("hearer", 0)];
    let mut trial = Trial::with(&nodes, on_board);
    trial.cluster.add_station("flood", Box::new(Flood(Some(ms(FLOOD_STARTS)))));
    trial.run_until(FLOOD_STARTS - 10);
    let (hearer, master) = (trial.node("hearer"), trial.node("master"));
    assert_eq!(trial.oddities(), Vec::<String>::new());
    trial.cluster.watch_handlers(hearer);
    trial.run_until(MASTER_GOES);
    trial.cluster.power_off(master);
    trial.run_until(END);

    let interrupts: Vec<VirtualInstant> = (trial.seen.iter())
        .filter(|seen| {
            matches!(seen.kind, ObservationKind::Handler { exception: CAN2_RX1, begins: true, .. })
        })
        .map(|seen| seen.at)
        .collect();
    let frames: Vec<(VirtualInstant, Frame)> = trial.frames_at(FLOOD_STARTS).collect();
    let (mut hearing, mut deaf) = (0, 0);
    let phases = phases(&trial);
    // A channel that is subscribed to without a broker has no etag.
    let is_settled = |phase: &&Phase| {
        (phase.begins > FLOOD_STARTS + 50 && phase.ends < MASTER_GOES) || phase.begins > DEPUTY_NAMES
    };
    for Phase { begins, ends, heard } in phases.iter().filter(is_settled) {
        let is_in = |at: VirtualInstant| (ms(*begins)..ms(*ends)).contains(&at);
        let sent = |is_it: &dyn Fn(&Frame) -> bool| {
            frames.iter().filter(|(at, frame)| is_in(*at) && is_it(frame)).count()
        };
        let counts = sent(&|frame| frame.id.etag() == COUNT);
        let protocol = sent(&|frame| frame.id.etag().is_reserved());
        let interrupts = interrupts.iter().filter(|at| is_in(**at)).count();
        let story = format!("{begins} to {ends}: {interrupts} of {counts} and {protocol}, {heard:?}");
        assert!(sent(&|frame| frame.id == FOREIGN) > 2_000, "{story}");
        assert!((37..=39).contains(&counts), "{story}");
        match heard {
            Some(heard) => {
                assert!((counts..=counts + protocol + 1).contains(&interrupts), "{story}");
                assert!((counts..=counts + 3).contains(heard), "{story}");
                hearing += 1;
            }
            None => {
                assert!(interrupts <= protocol + 1, "{story}");
                deaf += 1;
            }
        }
    }
    assert!(hearing >= 4 && deaf >= 4, "{hearing}, {deaf}");
    let is_odd = |kind: &ObservationKind| {
        matches!(kind, ObservationKind::NotModelled { .. } | ObservationKind::Stopped { .. })
    };
    assert!(!trial.seen.iter().any(|seen| is_odd(&seen.kind)));
}
