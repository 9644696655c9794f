//! The two halves of a node as RTIC tasks: the calendar task is never delayed by the lower half.
//!
//! | task | priority | does |
//! |---|---|---|
//! | `wire`, `peer` | 7 | stand for the bus and another node; no part of a node |
//! | `calendar` | 6 | calendar dispatcher and TTCH |
//! | `rx0` | 5 | hard real-time frames into their buffers |
//! | `tx` | 4 | outcomes of the mailboxes |
//! | `rx1` | 3 | other frames into the inbox |
//! | `etch` | 2 | takes in what has arrived, keeps the mailboxes filled |
//! | `application` | 1 | announces, publishes, subscribes |
//!
//! The application plays three acts. In the first the lower half has little to do. In the second it
//! computes without a pause, holds the event-triggered half for half a millisecond at a time, and fills
//! the bus, as does the peer; the calendar task must not notice. In the third it does what no program may
//! do, it turns interrupts off for 100 µs: to show that a delay, if there was one, would be seen.
#![no_std]
#![no_main]

#[rtic::app(
    device = qemu_tests::device,
    peripherals = false,
    dispatchers = [GPIO0_0, GPIO0_1, GPIO0_2, GPIO0_3],
)]
mod app {
    use core::cell::UnsafeCell;
    use core::sync::atomic::{AtomicU8, Ordering};

    use cosmic_core::Subject;
    use cosmic_core::calendar::{Calendar, Segment, Slot};
    use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
    use cosmic_core::event_half::{Due, EventHalf, HardAccess, Input, Step, outcome, receive};
    use cosmic_core::event_layer::{
        Channel, Event, ExceptionKind, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy,
        Publication, SoftAttributes, Subscription,
    };
    use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
    use cosmic_core::time::{Duration, GlobalClock, Instant};
    use heapless::Deque;
    use qemu_tests::hardware::CanHardware;
    use qemu_tests::mono::{self, Mono, Timebase as _, now};
    use qemu_tests::{measured, pass, println};
    use rtic::Mutex;
    use rtic_sync::signal::Signal;

    const NODE: TxNode = TxNode::MIN;
    const PEER: TxNode = TxNode::MAX;

    const CYCLE: Duration = Duration::from_millis(10);
    const SLOTS: [Slot; 2] = [slot(Etag::HARD_FIRST, NODE, 1), slot(Etag::HARD_LAST, PEER, 3)];
    const CALENDAR: Calendar = Calendar::checked(
        Segment {
            bit_rate: BitRate::MAX,
            accuracy: Duration::from_micros(5),
            // Of which the model of the bus, above all priorities, takes a good part.
            release_jitter: Duration::from_micros(20),
        },
        CYCLE,
        &SLOTS,
    );

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

    type Buffers = HrtBuffers<4>;
    type Node = EventHalf<4, 4, 4, 32, 16, 16, (), Locked>;
    /// What the interrupts and the calendar task hand to the event-triggered half, and when it happened.
    type Inbox = Deque<(Input, Instant), 32>;

    #[shared]
    struct Shared {
        node: Node,
        inbox: Inbox,
        hardware: CanHardware,
        /// The latest that the calendar task has come to an instant, in each act.
        latest: [Duration; 3],
    }

    #[local]
    struct Local {
        dispatcher: Dispatcher<4>,
    }

    /// Something has changed before the instant for which `wire` sleeps.
    static WIRE: Signal<()> = Signal::new();
    /// The same for `etch`.
    static ETCH: Signal<()> = Signal::new();

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        Mono::start();
        Locked.with(|buffers| buffers.set_clock(GlobalClock::free_running()));
        let mut node = Node::new(Some(NODE), &CALENDAR, (), Locked);
        let channels = Channels {
            hard: node.announce(&OF_NODE).unwrap(),
            soft: node.announce(&SOFT).unwrap(),
            bulk: node.announce(&BULK).unwrap(),
        };
        let from_peer = node.subscribe(&OF_PEER, Filter::ALL, Policy::Latest).unwrap();
        wire::spawn().unwrap();
        peer::spawn().unwrap();
        calendar::spawn().unwrap();
        etch::spawn().unwrap();
        application::spawn(channels, from_peer).ok().unwrap();
        let shared = Shared {
            node,
            inbox: Inbox::new(),
            hardware: CanHardware::new(BitRate::MAX),
            latest: [Duration::from_ticks(0); 3],
        };
        (shared, Local { dispatcher: Dispatcher::new(&CALENDAR) })
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        qemu_tests::sleep()
    }

    /// The bus: frames end at their instants.
    #[task(priority = 7, shared = [hardware])]
    async fn wire(mut cx: wire::Context) {
        let mut changed = WIRE.take_reader();
        loop {
            let next = cx.shared.hardware.lock(|hardware| {
                hardware.advance(now());
                hardware.next_event()
            });
            let _ = Mono::timeout_at(mono::instant(next), changed.wait()).await;
        }
    }

    /// Another node: sends in its slot, and much else while this one is busy.
    #[task(priority = 7, shared = [hardware])]
    async fn peer(mut cx: peer::Context) {
        let mut send = |priority, etag, payload| {
            let frame = Frame::new(Id::new(priority, PEER, etag), payload);
            cx.shared.hardware.lock(|hardware| hardware.peer_sends(frame, now()));
            WIRE.writer().write(());
        };
        for cycle in 0..u32::MAX {
            let start = Instant::EPOCH + CYCLE * cycle;
            // Some time after its ready instant, well before its latest start time.
            let loaded = start + SLOTS[1].phase + Duration::from_micros(50);
            Mono::delay_until(mono::instant(loaded)).await;
            send(Priority::HARD, SLOTS[1].etag, Payload::full(u64::from(cycle).to_be_bytes()));
            let mut at = start + Duration::from_millis(4);
            while ACT.load(Ordering::Relaxed) != IDLE && at < start + CYCLE {
                Mono::delay_until(mono::instant(at)).await;
                send(Priority::SOFT_LEAST_URGENT, Etag::BOUND_FIRST, Payload::full([0; 8]));
                at = at + Duration::from_micros(320);
            }
        }
    }

    #[task(priority = 6, local = [dispatcher], shared = [hardware, inbox, latest])]
    async fn calendar(mut cx: calendar::Context) {
        loop {
            match Locked.with(|buffers| cx.local.dispatcher.poll(now(), buffers)) {
                hard::CalendarStep::Command(command) => execute(command, &mut cx.shared.hardware),
                hard::CalendarStep::Notify(buffer) => {
                    post(Input::Notice(buffer), now(), &mut cx.shared.inbox)
                }
                hard::CalendarStep::Continue => {}
                hard::CalendarStep::SleepUntil(instant) => {
                    Mono::delay_until(mono::instant(instant)).await;
                    let late = now().saturating_since(instant);
                    let act = usize::from(ACT.load(Ordering::Relaxed));
                    cx.shared.latest.lock(|latest| latest[act] = latest[act].max(late));
                }
            }
        }
    }

    #[task(binds = GPIO0_4, priority = 5, shared = [hardware])]
    fn rx0(mut cx: rx0::Context) {
        let received_at = now();
        while let Some(frame) = cx.shared.hardware.lock(|hardware| hardware.receive(0)) {
            assert_eq!(receive(&frame, received_at, &mut Locked), None);
        }
    }

    #[task(binds = GPIO0_5, priority = 4, shared = [hardware, inbox])]
    fn tx(mut cx: tx::Context) {
        let at = now();
        for mailbox in Mailbox::ALL {
            let taken = cx.shared.hardware.lock(|hardware| hardware.take_outcome(mailbox));
            let Some(what) = taken else { continue };
            if let Some(input) = outcome(mailbox, what, at, &mut Locked) {
                post(input, at, &mut cx.shared.inbox);
            }
        }
    }

    #[task(binds = GPIO0_6, priority = 3, shared = [hardware, inbox])]
    fn rx1(mut cx: rx1::Context) {
        let received_at = now();
        while let Some(frame) = cx.shared.hardware.lock(|hardware| hardware.receive(1)) {
            if let Some(input) = receive(&frame, received_at, &mut Locked) {
                post(input, received_at, &mut cx.shared.inbox);
            }
        }
    }

    #[task(priority = 2, shared = [hardware, inbox, node])]
    async fn etch(mut cx: etch::Context) {
        let mut changed = ETCH.take_reader();
        loop {
            while let Some((input, at)) = cx.shared.inbox.lock(|inbox| inbox.pop_front()) {
                cx.shared.node.lock(|node| node.on_input(&input, at));
            }
            // One lock around all, so that commands reach the mailboxes in their order.
            let next = cx.shared.node.lock(|node| {
                loop {
                    match node.poll(now()) {
                        Step::Command(command) => execute(command, &mut cx.shared.hardware),
                        Step::SleepUntil(instant) => return instant,
                    }
                }
            });
            let _ = Mono::timeout_at(mono::instant(next), changed.wait()).await;
        }
    }

    #[task(priority = 1, shared = [hardware, latest, node])]
    async fn application(mut cx: application::Context, channels: Channels, from_peer: Subscription<u64>) {
        let mut report = Report::default();
        for cycle in 0..3 * CYCLES_PER_ACT {
            let act = (cycle / CYCLES_PER_ACT) as u8;
            ACT.store(act, Ordering::Relaxed);
            let event = Event::new(u64::from(cycle));
            let due = cx.shared.node.lock(|node| node.publish(now(), &channels.hard, &event).unwrap());
            assert!(due == Due::NOTHING, "a hard event waits for its slot");
            let end = Instant::EPOCH + CYCLE * (cycle + 1);
            while act == BUSY && now() < end.saturating_sub(LONG_CALL * 2) {
                cx.shared.node.lock(|node| long_call(node, &channels, &mut cx.shared.hardware));
                ETCH.writer().write(());
            }
            while act == CRIMINAL && now() < end.saturating_sub(CRIME * 2) {
                cortex_m::interrupt::free(|_| compute_until(now() + CRIME));
            }
            Mono::delay_until(mono::instant(end)).await;
            while let Some(delivered) = cx.shared.node.lock(|node| node.next(&from_peer)) {
                assert_eq!(delivered.publisher, PEER);
                assert_eq!(delivered.content, u64::from(cycle));
                report.delivered += 1;
            }
            if (cycle + 1) % CYCLES_PER_ACT == 0 {
                let latest = cx.shared.latest.lock(|latest| latest[usize::from(act)]);
                let sent = Locked.with(|buffers| {
                    let buffer = buffers.find(SLOTS[0].etag, NODE).unwrap();
                    buffers.counters(buffer).unwrap().sent
                });
                cx.shared.node.lock(|node| report.print(act, latest, sent, node));
            }
        }
        let overruns = cx.shared.hardware.lock(|hardware| hardware.overruns());
        measured!("{} frames of the peer lost in FIFOs", overruns);
        pass()
    }

    /// What the application publishes.
    pub struct Channels {
        hard: Publication<u64>,
        soft: Publication<u64>,
        bulk: Publication<u64>,
    }

    /// A long call in the lower half: it fills the queues and computes, all the while with the
    /// event-triggered half in its hands.
    fn long_call(node: &mut Node, channels: &Channels, hardware: &mut impl Mutex<T = CanHardware>) {
        let start = now();
        for publication in [&channels.soft, &channels.bulk] {
            // The last is refused: the queue is full.
            while let Ok(due) = node.publish(start, publication, &Event::new(0)) {
                due.command().into_iter().for_each(|command| execute(command, hardware));
            }
        }
        compute_until(start + LONG_CALL);
    }

    fn compute_until(end: Instant) {
        while now() < end {
            core::hint::spin_loop();
        }
    }

    fn execute(command: Command, hardware: &mut impl Mutex<T = CanHardware>) {
        hardware.lock(|hardware| hardware.execute(command, now()));
        WIRE.writer().write(());
    }

    fn post(input: Input, at: Instant, inbox: &mut impl Mutex<T = Inbox>) {
        assert!(inbox.lock(|inbox| inbox.push_back((input, at))).is_ok(), "the inbox is full");
        ETCH.writer().write(());
    }

    /// The message buffers of the node.
    static BUFFERS: BufferCell = BufferCell(UnsafeCell::new(Buffers::new(GlobalClock::unsynchronised())));

    struct BufferCell(UnsafeCell<Buffers>);

    // SAFETY: `Locked::with` is the only access. It turns interrupts off, and there is one processor, so no two
    // accesses overlap; the core's closures do not call it again.
    unsafe impl Sync for BufferCell {}

    /// Access with interrupts off, for the time of a copy.
    #[derive(Clone, Copy)]
    pub struct Locked;

    impl HardAccess<Buffers> for Locked {
        fn with<R>(&mut self, access: impl FnOnce(&mut Buffers) -> R) -> R {
            // SAFETY: as for `Sync`.
            cortex_m::interrupt::free(|_| access(unsafe { &mut *BUFFERS.0.get() }))
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
        fn print(&mut self, act: u8, latest: Duration, sent: u32, node: &Node) {
            let name = ["idle", "busy", "interrupts off"][usize::from(act)];
            let in_time = latest <= CALENDAR.segment().release_jitter;
            println!("{}: calendar task {}", name, if in_time { "in time" } else { "delayed" });
            measured!("{}: calendar task late by {} ns at most", name, latest.as_ticks());
            if act == CRIMINAL {
                return;
            }
            let soft = node.etch_counters().sent;
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
            measured!("{}: {:?}", name, node.etch_counters());
            (self.delivered_before, self.sent_before, self.soft_before) = (self.delivered, sent, soft);
        }
    }
}
