//! What a co-simulation relies on, with random commands: the bus stays quiet as long as it says, tells the
//! next event, does not care in how many steps time advances, and repeats itself exactly.

mod common;

use common::standard;
use cosmic_bus::trace::{Candump, TraceEvent};
use cosmic_bus::{
    Bus, BusOffRecovery, Chance, Event, EventKind, FaultModel, MAILBOXES, StationId, VirtualInstant,
    WireFrame,
};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;
use embedded_can::{ExtendedId, Frame as _};
use proptest::prelude::*;

const STATIONS: usize = 5;

#[derive(Clone, Debug)]
enum Command {
    Load {
        station: usize,
        mailbox: usize,
        frame: WireFrame,
    },
    Withdraw {
        station: usize,
        mailbox: usize,
    },
    Pass,
    /// Of the commands below, `quiet_until` says nothing.
    Connect {
        station: usize,
        connected: bool,
    },
    Reset {
        station: usize,
    },
    RequestRecovery {
        station: usize,
    },
}

/// A command, and how long after the one before it.
type Script = Vec<(Duration, Command)>;

/// Frames are loaded and withdrawn.
fn any_script() -> impl Strategy<Value = Script> {
    script_of(any_transfer().boxed())
}

/// Stations come and go besides.
fn any_eventful_script() -> impl Strategy<Value = Script> {
    let station = 0..STATIONS;
    let other = prop_oneof![
        2 => (station.clone(), any::<bool>())
            .prop_map(|(station, connected)| Command::Connect { station, connected }),
        1 => station.clone().prop_map(|station| Command::Reset { station }),
        1 => station.prop_map(|station| Command::RequestRecovery { station }),
    ];
    script_of(prop_oneof![3 => any_transfer(), 1 => other].boxed())
}

fn script_of(command: BoxedStrategy<Command>) -> impl Strategy<Value = Script> {
    let pause = prop_oneof![
        3 => Just(0),
        3 => 0..5_000_u64,
        3 => 0..300_000_u64,
        1 => 0..5_000_000_u64,
    ];
    prop::collection::vec((pause.prop_map(Duration::from_ticks), command), 1..80)
}

fn any_transfer() -> impl Strategy<Value = Command> {
    // Few identifiers: collisions of equal and of different contents are frequent.
    let frame = (0..6_u32, any::<bool>(), prop::collection::vec(prop_oneof![Just(0), Just(0xFF)], 0..=8))
        .prop_map(|(id, is_extended, data)| {
            if is_extended {
                WireFrame::new(ExtendedId::new(id).unwrap(), &data).unwrap()
            } else {
                standard(id as u16, &data)
            }
        });
    let place = || (0..STATIONS, 0..MAILBOXES);
    prop_oneof![
        4 => (place(), frame)
            .prop_map(|((station, mailbox), frame)| Command::Load { station, mailbox, frame }),
        1 => place().prop_map(|(station, mailbox)| Command::Withdraw { station, mailbox }),
        1 => Just(Command::Pass),
    ]
}

fn any_faults() -> impl Strategy<Value = FaultModel> {
    let chance = || prop_oneof![Just(0.0), Just(0.02), Just(0.5)];
    (any::<u64>(), chance(), chance()).prop_map(|(seed, inverted, omitted)| {
        FaultModel::seeded(seed)
            .with_inversion(Chance::new(inverted).unwrap())
            .with_omission(Chance::new(omitted).unwrap())
    })
}

struct Run {
    bus: Bus,
    stations: Vec<StationId>,
    at: VirtualInstant,
    loads: usize,
    trace: Vec<TraceEvent>,
}

impl Run {
    fn new(faults: FaultModel) -> Self {
        let mut bus = Bus::new(BitRate::MAX, faults);
        bus.record_trace(true);
        let stations: Vec<_> = (0..STATIONS).map(|number| bus.attach(format!("{number}"))).collect();
        bus.set_bus_off_recovery(stations[0], BusOffRecovery::OnRequest);
        Self { bus, stations, at: VirtualInstant::from_ticks(0), loads: 0, trace: Vec::new() }
    }

    fn command(&mut self, command: &Command) {
        match command {
            Command::Load { station, mailbox, frame } => {
                let loaded = self.bus.load(self.at, self.stations[*station], *mailbox, *frame);
                self.loads += usize::from(loaded.is_ok());
            }
            Command::Withdraw { station, mailbox } => {
                self.bus.withdraw(self.at, self.stations[*station], *mailbox);
            }
            Command::Pass => {}
            Command::Connect { station, connected: true } => {
                self.bus.connect(self.at, self.stations[*station]);
            }
            Command::Connect { station, connected: false } => {
                self.bus.disconnect(self.at, self.stations[*station]);
            }
            Command::Reset { station } => self.bus.reset(self.at, self.stations[*station]),
            Command::RequestRecovery { station } => {
                self.bus.request_recovery(self.at, self.stations[*station]);
            }
        }
    }

    /// All events, with one advance before each command.
    fn play(&mut self, script: &Script) -> Vec<Event> {
        let mut events = Vec::new();
        for (pause, command) in script {
            self.at += *pause;
            self.bus.advance(self.at, &mut events);
            self.command(command);
        }
        self.bus.advance(self.at + Duration::from_millis(100), &mut events);
        self.bus.take_trace(&mut self.trace);
        events
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    #[test]
    fn nothing_is_reported_before_the_bus_said(script in any_script(), faults in any_faults()) {
        let mut run = Run::new(faults);
        let mut quiet_until = run.bus.quiet_until();
        let mut events = Vec::new();
        for (pause, command) in &script {
            run.at += *pause;
            run.bus.advance(run.at, &mut events);
            run.command(command);
            run.bus.advance(run.at, &mut events);
            for event in events.drain(..) {
                // The answer to the command itself is the one exception.
                let is_answer = event.at == run.at && matches!(command, Command::Withdraw { .. })
                    && matches!(event.kind, EventKind::Withdrawn { .. });
                prop_assert!(is_answer || event.at >= quiet_until, "{event:?} before {quiet_until:?}");
            }
            // A promise stands until its instant has come; only then is a new one asked for.
            if quiet_until <= run.at {
                quiet_until = run.bus.quiet_until();
                prop_assert!(quiet_until >= run.at);
            }
        }
    }

    #[test]
    fn an_event_comes_when_foretold_and_none_before(
        script in any_eventful_script(), faults in any_faults()) {
        let mut run = Run::new(faults);
        let mut events = Vec::new();
        for (pause, command) in &script {
            run.at += *pause;
            run.bus.advance(run.at, &mut events);
            run.command(command);
            events.clear();
            let foretold = run.bus.next_event();
            run.bus.advance(run.at, &mut events);
            let silence = foretold.unwrap_or(run.at + Duration::from_secs(1));
            prop_assert!(events.is_empty() || silence == run.at);
            // Nobody does anything for a while.
            let mut silent = run.bus.next_event();
            while let Some(next) = silent.filter(|next| *next < run.at + Duration::from_micros(50)) {
                let before = VirtualInstant::from_ticks(next.as_ticks().saturating_sub(1));
                events.clear();
                run.bus.advance(before.max(run.bus.now()), &mut events);
                prop_assert!(events.iter().all(|event| event.at >= next));
                run.bus.advance(next, &mut events);
                silent = run.bus.next_event();
                prop_assert!(silent != Some(next) || run.bus.now() == next);
            }
            run.at = run.bus.now().max(run.at);
        }
    }

    #[test]
    fn the_number_of_steps_does_not_matter(
        script in any_eventful_script(),
        faults in any_faults(),
        step in 1_000..50_000_u64,
    ) {
        let at_once = Run::new(faults.clone()).play(&script);
        let mut run = Run::new(faults);
        let mut events = Vec::new();
        for (pause, command) in &script {
            let until = run.at + *pause;
            while run.bus.now() + Duration::from_ticks(step) < until {
                run.bus.advance(run.bus.now() + Duration::from_ticks(step), &mut events);
            }
            run.at = until;
            run.command(command);
        }
        let end = run.at + Duration::from_millis(100);
        while let Some(next) = run.bus.next_event().filter(|next| *next <= end) {
            run.bus.advance(next, &mut events);
        }
        run.bus.advance(end, &mut events);
        prop_assert_eq!(events, at_once);
    }

    #[test]
    fn one_seed_gives_one_trace_in_the_order_of_time(
        script in any_eventful_script(), faults in any_faults()) {
        let log = || {
            let mut run = Run::new(faults.clone());
            let events = run.play(&script);
            assert!(events.is_sorted_by_key(|event| event.at));
            assert!(run.trace.is_sorted_by_key(|event| event.at));
            let mut candump = Candump::new(Vec::new());
            run.trace.iter().for_each(|event| candump.write(event).unwrap());
            (events, run.trace, candump.into_inner())
        };
        prop_assert_eq!(log(), log());
    }

    #[test]
    fn each_load_ends_once(script in any_script(), seed in any::<u64>()) {
        let faults = FaultModel::seeded(seed).with_inversion(Chance::new(0.02).unwrap());
        let mut run = Run::new(faults);
        let mut events = run.play(&script);
        // What collides for ever is withdrawn in the end.
        for station in run.stations.clone() {
            for mailbox in 0..MAILBOXES {
                run.bus.withdraw(run.bus.now(), station, mailbox);
            }
        }
        run.bus.advance(run.bus.now() + Duration::from_millis(1), &mut events);
        let ends = events.iter().filter(|event| {
            matches!(event.kind, EventKind::Sent { .. } | EventKind::Withdrawn { .. })
        });
        prop_assert_eq!(ends.count(), run.loads);
    }
}
