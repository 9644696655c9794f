//! A node on the runtime as it is flashed: the calendar task is never delayed by the lower half.
//!
//! | task | priority | does |
//! |---|---|---|
//! | `bus`, `peer` | 7 | stand for the bus and another node; no part of a node |
//! | `calendar` | 6 | calendar dispatcher and TTCH |
//! | `urgent` | 5 | hard real-time frames into their buffers |
//! | `outcomes` | 4 | outcomes of the mailboxes |
//! | `other` | 3 | other frames into the inbox |
//! | `events` | 2 | takes in what has arrived, keeps the mailboxes filled |
//! | `application` | 1 | announces, publishes, subscribes |
//!
//! The application plays three acts. In the first the lower half has little to do. In the second it
//! computes without a pause, holds the node for half a millisecond at a time, and fills
//! the bus, as does the peer; the calendar task must not notice. In the third it does what no program may
//! do, it turns interrupts off for 100 µs: to show that a delay, if there was one, would be seen.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

#[rtic::app(
    device = qemu_tests::device,
    peripherals = false,
    dispatchers = [GPIO0_0, GPIO0_1, GPIO0_2, GPIO0_3],
)]
mod app {
    use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

    use cosmic_core::Subject;
    use cosmic_core::calendar::{Calendar as Plan, Segment, Slot};
    use cosmic_core::can::{BitRate, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
    use cosmic_core::event_layer::{
        Channel, ExceptionKind, HardAttributes, Importance, NonRealTimeAttributes, SoftAttributes,
    };
    use cosmic_core::plan::NodePlan;
    use cosmic_core::time::Instant;
    use cosmic_core::uid::NodeUid;
    use cosmic_rtic::prelude::*;
    use cosmic_rtic::{CalendarObserver, Observer, Observes, start_observed};
    use qemu_tests::board::{Machine, peer_sends, run_bus, with_hardware};
    use qemu_tests::mono::{Mono, now};
    use qemu_tests::{measured, pass, println};

    const NODE: TxNode = TxNode::MIN;
    const PEER: TxNode = TxNode::MAX;

    const CYCLE: Duration = Duration::from_millis(10);
    const SLOTS: [Slot; 2] = [slot(Etag::HARD_FIRST, NODE, 1), slot(Etag::HARD_LAST, PEER, 3)];
    const SEGMENT: Segment = Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        // Of which the model of the bus, above all priorities, takes a good part.
        release_jitter: Duration::from_micros(20),
    };
    static CALENDAR: Plan = Plan::checked(SEGMENT, CYCLE, &SLOTS);

    const fn slot(etag: Etag, publisher: TxNode, phase_ms: u64) -> Slot {
        Slot {
            etag,
            publisher,
            len: 8,
            omission_degree: 1,
            periodic: true,
            period: CYCLE,
            phase: Duration::from_millis(phase_ms),
        }
    }

    const HARD: HardAttributes = HardAttributes { period: CYCLE, periodic: true, omission_degree: 1 };
    const OF_NODE: Channel<u64> = Channel::hard(Subject::new(1).unwrap(), SLOTS[0].etag, HARD);
    const OF_PEER: Channel<u64> = Channel::hard(Subject::new(2).unwrap(), SLOTS[1].etag, HARD);
    const SOFT: Channel<u64> = Channel::soft(
        Subject::new(3).unwrap(),
        SoftAttributes { deadline: Duration::from_millis(2), validity: Duration::from_millis(4) },
    )
    .with_etag(Etag::BOUND_FIRST);
    const BULK: Channel<u64> = Channel::non_real_time(
        Subject::new(4).unwrap(),
        NonRealTimeAttributes { importance: Importance::MOST, validity: None },
    )
    .with_etag(Etag::BOUND_LAST);

    const PLAN: NodePlan = NodePlan {
        name: "node",
        uid: NodeUid::new(1).unwrap(),
        tx_node: Some(NODE),
        sync: None,
        filters: &[],
        named_at_run_time: false,
        calendar: &CALENDAR,
        seal: None,
        admission: None,
        publishes: &[],
        subscribes: &[],
    };

    /// How long the lower half holds its resources, in the second act.
    const LONG_CALL: Duration = Duration::from_micros(500);
    /// How long it turns interrupts off, in the third.
    const CRIME: Duration = Duration::from_micros(100);
    const CYCLES_PER_ACT: u32 = 25;

    /// What the lower half is doing.
    static ACT: AtomicU8 = AtomicU8::new(IDLE);
    const IDLE: u8 = 0;
    const BUSY: u8 = 1;
    const CRIMINAL: u8 = 2;

    cosmic_core::capacity! {
        Room { slots: 4, channels: 4, subscriptions: 4, events: 32, soft: 16, non_real_time: 16 }
    }

    /// The node. Local time is global time.
    pub struct Tested;

    impl System for Tested {
        type Board = Machine;
        type Capacity = Room;
        type Services = ();
        type Observer = Watcher;
    }

    /// Watches the calendar task only.
    pub struct Watcher;

    impl Observer for Watcher {
        type Calendar = Punctuality;
    }

    impl<C> Observes<C> for Watcher {}

    /// The latest that the calendar task has come to an instant, in nanoseconds, in each act.
    static LATEST: [AtomicU32; 3] = [const { AtomicU32::new(0) }; 3];

    /// Notes how late the calendar task is.
    pub struct Punctuality;

    impl CalendarObserver for Punctuality {
        fn running(&mut self, runs: bool) {
            let now = now();
            if runs && now >= Instant::EPOCH + SLOTS[0].phase {
                LATEST[usize::from(ACT.load(Ordering::Relaxed))].fetch_max(lateness(now), Ordering::Relaxed);
            }
        }
    }

    /// How long ago the last instant of the calendar was for which this node wakes.
    fn lateness(now: Instant) -> u32 {
        let [own, of_peer] = [&SLOTS[0], &SLOTS[1]];
        let instants = [
            own.phase,
            own.phase + CALENDAR.slot_times(own).deadline + SEGMENT.release_jitter,
            of_peer.phase,
            of_peer.phase + CALENDAR.slot_times(of_peer).delivery,
        ];
        let in_cycle = now.since_epoch().as_ticks() % CYCLE.as_ticks();
        let since = instants.map(|instant| in_cycle.checked_sub(instant.as_ticks()));
        // Before the first of a cycle: the last one was in the cycle before.
        let latest = since.into_iter().flatten().min();
        latest.unwrap_or(in_cycle + CYCLE.as_ticks() - instants[3].as_ticks()) as u32
    }

    #[shared]
    struct Shared {
        node: Node<Tested>,
    }

    #[local]
    struct Local {
        urgent: Urgent<Tested>,
        outcomes: Outcomes<Tested>,
        other: Other<Tested>,
    }

    #[init(local = [storage: Storage<Tested> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        Mono::start();
        let parts = start_observed(Machine, &PLAN, cx.local.storage, Watcher, Punctuality);
        let Ok(Parts { calendar, urgent, outcomes, other, events, node, .. }) = parts else {
            panic!("these services need nothing of the plan");
        };
        spawn!(bus(), peer(), calendar(calendar), events(events), application());
        (Shared { node }, Local { urgent, outcomes, other })
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        qemu_tests::sleep()
    }

    #[task(priority = 7)]
    async fn bus(_: bus::Context) {
        run_bus().await
    }

    /// Another node: sends in its slot, and much else while this one is busy.
    #[task(priority = 7)]
    async fn peer(_: peer::Context) {
        let send = |priority, etag, payload| peer_sends(Frame::new(Id::new(priority, PEER, etag), payload));
        for cycle in 0..u32::MAX {
            let start = Instant::EPOCH + CYCLE * cycle;
            // Some time after its ready instant, well before its latest start time.
            Machine::delay_until(start + SLOTS[1].phase + Duration::from_micros(50)).await;
            send(Priority::HARD, SLOTS[1].etag, Payload::full(u64::from(cycle).to_be_bytes()));
            let mut at = start + Duration::from_millis(4);
            while ACT.load(Ordering::Relaxed) != IDLE && at < start + CYCLE {
                Machine::delay_until(at).await;
                send(Priority::SOFT_LEAST_URGENT, Etag::BOUND_FIRST, Payload::full([0; 8]));
                at = at + Duration::from_micros(320);
            }
        }
    }

    #[task(priority = 6)]
    async fn calendar(_: calendar::Context, mut part: Calendar<Tested>) {
        part.run().await
    }

    #[task(binds = GPIO0_4, local = [urgent], priority = 5)]
    fn urgent(cx: urgent::Context) {
        cx.local.urgent.run();
    }

    #[task(binds = GPIO0_5, local = [outcomes], priority = 4)]
    fn outcomes(cx: outcomes::Context) {
        cx.local.outcomes.run();
    }

    #[task(binds = GPIO0_6, local = [other], priority = 3)]
    fn other(cx: other::Context) {
        cx.local.other.run();
    }

    #[task(shared = [node], priority = 2)]
    async fn events(cx: events::Context, mut part: Events) {
        part.run(cx.shared.node).await
    }

    #[task(shared = [node], priority = 1)]
    async fn application(mut cx: application::Context) {
        let node = &mut cx.shared.node;
        let hard = Publisher::announce(&OF_NODE, node).unwrap();
        let soft = Publisher::announce(&SOFT, node).unwrap();
        let bulk = Publisher::announce(&BULK, node).unwrap();
        let from_peer = Subscriber::subscribe(&OF_PEER, Policy::Latest, node).unwrap();
        let mut report = Report::default();
        for cycle in 0..3 * CYCLES_PER_ACT {
            let act = (cycle / CYCLES_PER_ACT) as u8;
            ACT.store(act, Ordering::Relaxed);
            hard.publish(u64::from(cycle), node).unwrap();
            let end = Instant::EPOCH + CYCLE * (cycle + 1);
            while act == BUSY && now() < end.saturating_sub(LONG_CALL * 2) {
                node.lock(|node| long_call([&soft, &bulk], &mut Held(node)));
            }
            while act == CRIMINAL && now() < end.saturating_sub(CRIME * 2) {
                cortex_m::interrupt::free(|_| compute_until(now() + CRIME));
            }
            Machine::delay_until(end).await;
            while let Some(delivered) = from_peer.try_next(node) {
                assert_eq!(delivered.publisher, PEER);
                assert_eq!(delivered.content, u64::from(cycle));
                report.delivered += 1;
            }
            if (cycle + 1) % CYCLES_PER_ACT == 0 {
                node.lock(|node| report.print(act, node));
            }
        }
        let lost = node.lock(|node| node.exceptions(ExceptionKind::InputLost));
        measured!("{} frames of the peer lost in FIFOs", lost);
        pass()
    }

    /// A node that is locked already, for calls that lock it.
    struct Held<'a>(&'a mut Node<Tested>);

    impl Mutex for Held<'_> {
        type T = Node<Tested>;

        fn lock<R>(&mut self, work: impl FnOnce(&mut Self::T) -> R) -> R {
            work(self.0)
        }
    }

    /// A long call in the lower half: it fills the queues and computes, all the while with the node in its
    /// hands.
    fn long_call(publishers: [&Publisher<u64>; 2], node: &mut Held<'_>) {
        let start = now();
        for publisher in publishers {
            // The last is refused: the queue is full.
            while publisher.publish(0, node).is_ok() {}
        }
        compute_until(start + LONG_CALL);
    }

    fn compute_until(end: Instant) {
        while now() < end {
            core::hint::spin_loop();
        }
    }

    /// What happened, act by act.
    #[derive(Default)]
    struct Report {
        delivered: u32,
        delivered_before: u32,
        sent_before: u32,
        soft_before: u32,
    }

    impl Report {
        fn print(&mut self, act: u8, node: &Node<Tested>) {
            let name = ["idle", "busy", "interrupts off"][usize::from(act)];
            let latest = LATEST[usize::from(act)].load(Ordering::Relaxed);
            let in_time = u64::from(latest) <= SEGMENT.release_jitter.as_ticks();
            println!("{}: calendar task {}", name, if in_time { "in time" } else { "delayed" });
            measured!("{}: calendar task late by {} ns at most", name, latest);
            if act == CRIMINAL {
                return;
            }
            let sent = with_hardware(|hardware| hardware.sent(Mailbox::Hard));
            let of = |channel: &Channel<u64>| node.channel_counters(channel.subject()).unwrap().sent;
            let soft = of(&SOFT) + of(&BULK);
            println!("  hard events sent: {}", sent - self.sent_before);
            println!("  hard events delivered: {}", self.delivered - self.delivered_before);
            println!(
                "  soft events sent: {}",
                if soft - self.soft_before >= 100 { "hundreds" } else { "few" }
            );
            for kind in [
                ExceptionKind::OmissionDegreeExceeded,
                ExceptionKind::NothingPublished,
                ExceptionKind::SlotSkipped,
                ExceptionKind::MissedEvent,
                ExceptionKind::QueueFull,
                ExceptionKind::EventOverwritten,
            ] {
                assert_eq!(node.exceptions(kind), 0, "{kind:?}");
            }
            measured!("{}: {} soft events sent", name, soft - self.soft_before);
            (self.delivered_before, self.sent_before, self.soft_before) = (self.delivered, sent, soft);
        }
    }
}
