//! The two halves of a node as RTIC tasks: the calendar task is never delayed by the lower half.
//!
//! | task | priority | does |
//! |---|---|---|
//! | `wire`, `peer` | 7 | stand for the bus and another node; no part of a node |
//! | `calendar` | 6 | calendar dispatcher and TTCH |
//! | `rx0` | 5 | hard real-time frames into their buffers |
//! | `tx` | 4 | outcomes of the mailboxes, refill |
//! | `rx1` | 3 | other frames |
//! | `etch` | 2 | EDF queue: promotion, missed deadlines, expiry |
//! | `event_layer` | 1 | the application |
//!
//! The application has three acts. In the first the lower half is idle. In the second it computes without
//! a pause, holds its own resources for half a millisecond at a time, and fills the bus, as does the peer;
//! the calendar task must not notice. In the third it does what no program may do, it turns interrupts
//! off for 100 µs: to show that a delay, if there was one, would be seen.
#![no_std]
#![no_main]

#[rtic::app(
    device = qemu_tests::device,
    peripherals = false,
    dispatchers = [GPIO0_0, GPIO0_1, GPIO0_2, GPIO0_3],
)]
mod app {
    use core::sync::atomic::{AtomicU8, Ordering};

    use cosmic_core::calendar::{Calendar, Segment, Slot};
    use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
    use cosmic_core::network::hard::{self, Attach, BufferId, Dispatcher, HrtBuffers, Role};
    use cosmic_core::network::soft::{self, Etch, Outgoing, PriorityMap, Tag};
    use cosmic_core::time::{Duration, GlobalClock, Instant};
    use qemu_tests::hardware::CanHardware;
    use qemu_tests::mono::{self, Mono, Timebase as _, now};
    use qemu_tests::{measured, pass, println};
    use rtic_sync::make_signal;
    use rtic_sync::signal::{SignalReader, SignalWriter};

    const NODE: TxNode = TxNode::MIN;
    const PEER: TxNode = TxNode::MAX;
    const SENT_HARD: Etag = Etag::HARD_FIRST;
    const RECEIVED_HARD: Etag = Etag::HARD_LAST;
    const SOFT: Etag = Etag::BOUND_LAST;

    const CYCLE: Duration = Duration::from_millis(10);
    const SLOTS: [Slot; 2] = [slot(SENT_HARD, NODE, 1), slot(RECEIVED_HARD, PEER, 3)];
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

    #[shared]
    struct Shared {
        hard: HrtBuffers<4>,
        etch: Etch<16, 16>,
        hardware: CanHardware,
        /// The latest that the calendar task has come to an instant, in each act.
        latest: [Duration; 3],
        received_soft: u32,
    }

    #[local]
    struct Local {
        wire_after_calendar: SignalWriter<'static, ()>,
        wire_after_tx: SignalWriter<'static, ()>,
        wire_after_etch: SignalWriter<'static, ()>,
        wire_after_peer: SignalWriter<'static, ()>,
        etch_after_tx: SignalWriter<'static, ()>,
        etch_after_submit: SignalWriter<'static, ()>,
    }

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        Mono::start();
        let mut hard = HrtBuffers::new(GlobalClock::free_running());
        let [publishes, subscribes] =
            [true, false].map(|publishes| Role { publishes, subscribes: !publishes });
        let sent = hard.attach(&Attach { calendar: &CALENDAR, slot: &SLOTS[0], role: publishes }).unwrap();
        let received =
            hard.attach(&Attach { calendar: &CALENDAR, slot: &SLOTS[1], role: subscribes }).unwrap();
        let (to_wire, wire_changed) = make_signal!(());
        let (to_etch, etch_changed) = make_signal!(());
        wire::spawn(wire_changed).ok().unwrap();
        peer::spawn().ok().unwrap();
        calendar::spawn().ok().unwrap();
        etch::spawn(etch_changed).ok().unwrap();
        event_layer::spawn(sent, received).ok().unwrap();
        let shared = Shared {
            hard,
            etch: Etch::new(PriorityMap::of(BitRate::MAX)),
            hardware: CanHardware::new(BitRate::MAX),
            latest: [Duration::from_ticks(0); 3],
            received_soft: 0,
        };
        let local = Local {
            wire_after_calendar: to_wire.clone(),
            wire_after_tx: to_wire.clone(),
            wire_after_etch: to_wire.clone(),
            wire_after_peer: to_wire,
            etch_after_tx: to_etch.clone(),
            etch_after_submit: to_etch,
        };
        (shared, local)
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        qemu_tests::sleep()
    }

    /// The bus: frames end at their instants.
    #[task(priority = 7, shared = [hardware])]
    async fn wire(mut cx: wire::Context, mut changed: SignalReader<'static, ()>) {
        loop {
            let next = cx.shared.hardware.lock(|hardware| {
                hardware.advance(now());
                hardware.next_event()
            });
            let _ = Mono::timeout_at(mono::instant(next), changed.wait()).await;
        }
    }

    /// Another node: sends in its slot, and while this one is busy as much other traffic again.
    #[task(priority = 7, local = [wire_after_peer], shared = [hardware])]
    async fn peer(mut cx: peer::Context) {
        let frame = |priority, etag, payload| Frame::new(Id::new(priority, PEER, etag), payload);
        let mut cycle = Instant::EPOCH;
        for count in 1_u64.. {
            // Well before the latest start time.
            let ready = cycle + SLOTS[1].phase + Duration::from_micros(50);
            Mono::delay_until(mono::instant(ready)).await;
            let hard = frame(Priority::HARD, RECEIVED_HARD, Payload::full(count.to_be_bytes()));
            cx.shared.hardware.lock(|hardware| hardware.peer_sends(hard, now()));
            cx.local.wire_after_peer.write(());
            cycle = cycle + CYCLE;
            let mut at = ready + Duration::from_millis(1);
            while ACT.load(Ordering::Relaxed) != IDLE && at < cycle {
                Mono::delay_until(mono::instant(at)).await;
                let soft = frame(Priority::SOFT_LEAST_URGENT, SOFT, Payload::EMPTY);
                cx.shared.hardware.lock(|hardware| hardware.peer_sends(soft, now()));
                cx.local.wire_after_peer.write(());
                at = at + Duration::from_micros(160);
            }
        }
    }

    #[task(priority = 6, local = [wire_after_calendar], shared = [hard, hardware, latest])]
    async fn calendar(mut cx: calendar::Context) {
        let mut dispatcher = Dispatcher::<4>::new(&CALENDAR);
        loop {
            match cx.shared.hard.lock(|hard| dispatcher.poll(now(), hard)) {
                hard::Step::Command(command) => {
                    cx.shared.hardware.lock(|hardware| hardware.execute(command, now()));
                    cx.local.wire_after_calendar.write(());
                }
                // The event layer looks by itself.
                hard::Step::Notify(_) | hard::Step::Continue => {}
                hard::Step::SleepUntil(instant) => {
                    Mono::delay_until(mono::instant(instant)).await;
                    let late = now().saturating_since(instant);
                    let act = usize::from(ACT.load(Ordering::Relaxed));
                    cx.shared.latest.lock(|latest| latest[act] = latest[act].max(late));
                }
            }
        }
    }

    #[task(binds = GPIO0_4, priority = 5, shared = [hard, hardware])]
    fn rx0(mut cx: rx0::Context) {
        let received_at = now();
        while let Some(frame) = cx.shared.hardware.lock(|hardware| hardware.receive(0)) {
            assert!(cx.shared.hard.lock(|hard| hard.on_frame(&frame, received_at)));
        }
    }

    #[task(binds = GPIO0_5, priority = 4, local = [wire_after_tx, etch_after_tx], shared = [hard, etch, hardware])]
    fn tx(mut cx: tx::Context) {
        let at = now();
        if let Some(outcome) = cx.shared.hardware.lock(|hardware| hardware.take_outcome(Mailbox::Hard)) {
            cx.shared.hard.lock(|hard| hard.on_outcome(outcome, at));
        }
        for mailbox in [Mailbox::Soft, Mailbox::NonRealTime] {
            if let Some(outcome) = cx.shared.hardware.lock(|hardware| hardware.take_outcome(mailbox)) {
                // An exception is counted by the path.
                let _ = cx.shared.etch.lock(|etch| etch.on_outcome(mailbox, outcome, at));
            }
        }
        refill(&mut cx.shared.etch, &mut cx.shared.hardware);
        cx.local.wire_after_tx.write(());
        cx.local.etch_after_tx.write(());
    }

    #[task(binds = GPIO0_6, priority = 3, shared = [hardware, received_soft])]
    fn rx1(mut cx: rx1::Context) {
        while cx.shared.hardware.lock(|hardware| hardware.receive(1)).is_some() {
            cx.shared.received_soft.lock(|count| *count += 1);
        }
    }

    #[task(priority = 2, local = [wire_after_etch], shared = [etch, hardware])]
    async fn etch(mut cx: etch::Context, mut changed: SignalReader<'static, ()>) {
        loop {
            let next = refill(&mut cx.shared.etch, &mut cx.shared.hardware);
            cx.local.wire_after_etch.write(());
            let _ = Mono::timeout_at(mono::instant(next), changed.wait()).await;
        }
    }

    /// Has the path do what is due, and gives the instant until which nothing more is.
    fn refill(
        etch: &mut impl rtic::Mutex<T = Etch<16, 16>>,
        hardware: &mut impl rtic::Mutex<T = CanHardware>,
    ) -> Instant {
        // The lock is held across the loop, so that commands reach the mailboxes in their order.
        etch.lock(|etch| {
            loop {
                match etch.poll(now()) {
                    soft::Step::Command(command) => {
                        hardware.lock(|hardware| hardware.execute(command, now()));
                    }
                    soft::Step::Exception(_) => {}
                    soft::Step::SleepUntil(instant) => return instant,
                }
            }
        })
    }

    #[task(
        priority = 1,
        local = [etch_after_submit],
        shared = [hard, etch, hardware, latest, received_soft],
    )]
    async fn event_layer(mut cx: event_layer::Context, sent: BufferId, received: BufferId) {
        let mut delivered = 0;
        for (act, name) in [(IDLE, "idle"), (BUSY, "busy"), (CRIMINAL, "interrupts off")] {
            ACT.store(act, Ordering::Relaxed);
            let before = cx.shared.hard.lock(|hard| hard.counters(sent).unwrap());
            let delivered_before = delivered;
            let sent_soft_before = cx.shared.etch.lock(|etch| etch.counters().sent);
            for cycle in 1..=CYCLES_PER_ACT {
                let cycles = u32::from(act) * CYCLES_PER_ACT + cycle;
                let end = Instant::EPOCH + CYCLE * cycles;
                cx.shared.hard.lock(|hard| hard.publish(sent, Payload::full([cycle as u8; 8])));
                while act == BUSY && now() < end.saturating_sub(LONG_CALL + LONG_CALL) {
                    cx.shared.etch.lock(|etch| {
                        let hardware = &mut cx.shared.hardware;
                        long_call(etch, |command| {
                            hardware.lock(|hardware| hardware.execute(command, now()));
                        });
                    });
                    cx.local.etch_after_submit.write(());
                }
                while act == CRIMINAL && now() < end.saturating_sub(CRIME + CRIME) {
                    cortex_m::interrupt::free(|_| compute_until(now() + CRIME));
                }
                Mono::delay_until(mono::instant(end)).await;
                if let Some(delivery) = cx.shared.hard.lock(|hard| hard.take(received)) {
                    delivered += 1;
                    if act != CRIMINAL {
                        assert_eq!(delivery.payload, Payload::full(u64::to_be_bytes(delivered)));
                    }
                }
            }
            let counts = cx.shared.hard.lock(|hard| hard.counters(sent).unwrap());
            let latest = cx.shared.latest.lock(|latest| latest[usize::from(act)]);
            let in_time = latest <= CALENDAR.segment().release_jitter;
            println!("{}: calendar task {}", name, if in_time { "in time" } else { "delayed" });
            measured!("{}: calendar task late by {} ns at most", name, latest.as_ticks());
            if act != CRIMINAL {
                println!("  hard events sent: {}", counts.sent - before.sent);
                println!("  hard events delivered: {}", delivered - delivered_before);
                let sent_soft = cx.shared.etch.lock(|etch| etch.counters().sent) - sent_soft_before;
                println!("  soft events sent: {}", if sent_soft >= 100 { "hundreds" } else { "few" });
                measured!("{}: {} soft events sent", name, sent_soft);
            }
        }
        let received_soft = cx.shared.received_soft.lock(|count| *count);
        let overruns = cx.shared.hardware.lock(|hardware| hardware.overruns());
        measured!("{} soft events of the peer received, {} lost", received_soft, overruns);
        pass()
    }

    /// A long call of the event layer: it fills the queues and computes, all the while with the
    /// resources of the lower half in its hands.
    fn long_call(etch: &mut Etch<16, 16>, mut execute: impl FnMut(Command)) {
        let start = now();
        for tag in 0..16 {
            let id = Id::new(Priority::LEAST, NODE, SOFT);
            let deadline = start + Duration::from_millis(2);
            let expires_at = start + Duration::from_millis(4);
            let frame = Frame::new(id, Payload::full([tag; 8]));
            let event = Outgoing { tag: Tag(tag), frame, deadline, expires_at };
            // Most are refused, because the queues are full already.
            for submitted in [etch.submit_non_real_time(start, event), etch.submit_soft(start, event)] {
                submitted.ok().flatten().into_iter().for_each(&mut execute);
            }
        }
        compute_until(start + LONG_CALL);
    }

    fn compute_until(end: Instant) {
        while now() < end {
            core::hint::spin_loop();
        }
    }
}
