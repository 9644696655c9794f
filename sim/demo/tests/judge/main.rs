//! The judge of the demonstration, on runs of the core on the host: it must see what went wrong, and nothing
//! else.

mod host_cluster;

use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{BitPosition, Bus, Chance, Fault, FaultModel, Filter, Rule, VirtualInstant, WireFrame};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, Instant};
use cosmic_demo::bus_log::BusLog;
use cosmic_demo::clock::NodeClock;
use cosmic_demo::example::{Channel, EXAMPLE};
use cosmic_demo::hard::Fate;
use cosmic_demo::journal::Journal;
use cosmic_demo::picture;
use cosmic_demo::record::{Digest, Queue, Record, RecordKind};
use cosmic_demo::report::{Report, Settings};
use cosmic_demo::table::{Style, Tables, WIDTH};
use cosmic_demo::verdict::Verdict;
use cosmic_demo::violation::{Loss, Violation};
use embedded_can::ExtendedId;
use host_cluster::{Meddling, Run, content};

const SETTINGS: Settings = Settings { seconds: 1.0, seed: 1, load_percent: 0.0, error_rate: 0.0, burst: 0 };

fn wheel() -> Etag {
    EXAMPLE.channels[0].etag
}

fn brake() -> TxNode {
    EXAMPLE.nodes[1].tx_node
}

/// The digest of an event of the nodes on the host.
fn event(number: u32) -> Digest {
    Digest::of(&content(number))
}

fn at_ms(ms: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(ms * 1_000_000)
}

/// Destroys the next attempts to send the wheel speed, near their ends.
fn burst(bus: &mut Bus, count: u32) {
    let slot = EXAMPLE.calendar.slots()[0];
    let id = Id::new(Priority::HARD, slot.publisher, slot.etag);
    let frames = Filter::exactly(ExtendedId::new(id.raw()).unwrap().into());
    let fault = Fault::Inverted(BitPosition::FromEnd(12));
    bus.faults_mut().add_rule(Rule { frames, skip: 0, count, fault });
}

fn summary(journal: &Journal, verdict: &Verdict) -> String {
    let report = Report::of(SETTINGS, journal, verdict);
    Tables { report: &report, style: Style::Plain }.to_string()
}

#[test]
fn a_quiet_run_passes_and_every_slot_is_seen() {
    let journal = Run::quiet(1_000).journal();
    let verdict = Verdict::of(&journal);
    let text = summary(&journal, &verdict);
    assert!(verdict.is_passed(), "{text}");
    let settled = verdict.slots.settled_at.unwrap();
    assert!(settled < at_ms(600), "{settled}");
    let judged: Vec<_> = verdict.slots.occurrences.iter().filter(|it| it.fate.is_judged()).collect();
    assert!(judged.len() > 40, "{}", judged.len());
    assert!(judged.iter().all(|it| it.fate == Fate::Delivered && it.attempts.len() == 1), "{text}");
    // ε of a settled node is far below the calendar's.
    let off = verdict.slots.deviation.range().unwrap();
    assert!(off.max.as_micros() < 10.0 && off.min.as_micros() > -10.0, "{text}");
    // 1 ms periods in a second, from 8 ms on.
    let suspension = &verdict.totals[3];
    assert!((985..=993).contains(&suspension.published), "{}", suspension.published);
    assert_eq!((suspension.missed, suspension.expired), (0, 0));
}

#[test]
fn faults_within_the_omission_degree_change_no_delivery_instant() {
    let faults = FaultModel::seeded(11).with_inversion(Chance::new(0.03).unwrap());
    let journal = Run { faults, load_interval: 180, ..Run::quiet(3_000) }.journal();
    let verdict = Verdict::of(&journal);
    let text = summary(&journal, &verdict);
    let faulted = verdict.slots.occurrences.iter().filter(|it| it.fate == Fate::Delivered && it.faulted == 1);
    assert!(faulted.count() > 0, "{text}");
    assert!(verdict.is_passed(), "{text}");
    assert!(verdict.order.contests > 0, "{text}");
}

#[test]
fn a_loss_beyond_the_omission_degree_is_lost_and_reported() {
    let meddle: Vec<Meddling> = vec![(at_ms(700), |bus| burst(bus, 6))];
    let journal = Run { meddle, ..Run::quiet(1_000) }.journal();
    let verdict = Verdict::of(&journal);
    let text = summary(&journal, &verdict);
    let lost: Vec<_> = verdict.slots.occurrences.iter().filter(|it| it.fate == Fate::Lost).collect();
    assert!(!lost.is_empty() && lost.iter().all(|it| it.faulted > 1), "{text}");
    let count = |node, kind| verdict.ledger.count(node, wheel(), kind);
    assert_eq!(count(EXAMPLE.nodes[0].tx_node, ExceptionKind::OmissionDegreeExceeded), lost.len());
    assert_eq!(count(brake(), ExceptionKind::MissedEvent), lost.len());
    assert!(verdict.is_passed(), "{text}");
    assert!(text.contains("omission degree exceeded") && text.contains("missed event"), "{text}");
}

/// Removes records of a passing run; the judge must miss them.
fn without(keep: impl Fn(&TxNode, &RecordKind, Option<Etag>) -> bool) -> Verdict {
    let meddle: Vec<Meddling> = vec![(at_ms(700), |bus| burst(bus, 6))];
    let mut journal = Run { meddle, ..Run::quiet(1_000) }.journal();
    assert!(Verdict::of(&journal).is_passed());
    let etag = |record: &Record| record.channel.and_then(|number| EXAMPLE.etag(number));
    journal.records.retain(|(node, record)| keep(node, &record.kind, etag(record)));
    Verdict::of(&journal)
}

#[test]
fn silence_at_the_publisher_is_found() {
    let told = RecordKind::Exception(ExceptionKind::OmissionDegreeExceeded);
    let verdict = without(|_, kind, _| *kind != told);
    let expected =
        |it: &Violation| matches!(it, Violation::Silence { kind: ExceptionKind::OmissionDegreeExceeded, .. });
    assert!(
        !verdict.violations.is_empty() && verdict.violations.iter().all(expected),
        "{:?}",
        verdict.violations
    );
}

#[test]
fn silence_at_a_subscriber_is_found() {
    let verdict = without(|node, kind, _| {
        *node != brake() || *kind != RecordKind::Exception(ExceptionKind::MissedEvent)
    });
    let expected = |it: &Violation| matches!(it, Violation::Silence { node, kind: ExceptionKind::MissedEvent, .. } if *node == brake());
    assert!(
        !verdict.violations.is_empty() && verdict.violations.iter().all(expected),
        "{:?}",
        verdict.violations
    );
}

#[test]
fn a_hard_event_that_is_not_delivered_is_found() {
    let verdict = without(|node, kind, etag| {
        let gone = matches!(kind, RecordKind::Delivered { digest, .. } if *digest == event(90));
        !(gone && etag == Some(wheel()) && *node == brake())
    });
    assert!(
        matches!(verdict.violations.as_slice(), [Violation::NotDelivered { faulted: 0, .. }]),
        "{:?}",
        verdict.violations
    );
}

#[test]
fn a_soft_event_that_vanishes_is_found() {
    let suspension = EXAMPLE.channels[3].etag;
    let verdict = without(|_, kind, etag| {
        !(matches!(kind, RecordKind::Delivered { digest, .. } if *digest == event(500))
            && etag == Some(suspension))
    });
    let [Violation::Unreported { what: Loss::Undelivered, lost: 1, reported: 0, .. }] =
        verdict.violations.as_slice()
    else {
        panic!("{:?}", verdict.violations);
    };
}

#[test]
fn a_missing_record_is_found() {
    let verdict = without(|_, kind, etag| {
        !(matches!(kind, RecordKind::Published { digest, .. } if *digest == event(500))
            && etag == Some(EXAMPLE.channels[3].etag))
    });
    // The frame, and what arrived of it, are of no event that was published.
    assert_eq!(verdict.violations, [Violation::Invented { count: 2 }]);
}

/// A passing run with more records at its end.
fn with(records: impl IntoIterator<Item = (TxNode, RecordKind)>) -> Vec<Violation> {
    let mut journal = Run::quiet(1_000).journal();
    let at = journal.records.last().unwrap().1.at;
    let record = |(node, kind)| (node, Record { channel: Some(0), at, kind });
    journal.records.extend(records.into_iter().map(record));
    Verdict::of(&journal).violations
}

#[test]
fn records_that_nobody_read_in_time_are_missed() {
    let violations = with([(brake(), RecordKind::Lost { count: 3 })]);
    assert_eq!(violations, [Violation::RecordsLost { node: brake(), count: 3 }]);
}

#[test]
fn an_event_that_nobody_published_is_found() {
    let visible_at = Instant::from_epoch(Duration::from_millis(800));
    let (publisher, digest) = (EXAMPLE.nodes[0].tx_node, Digest::of(b"invented"));
    let violations = with([(brake(), RecordKind::Delivered { digest, publisher, visible_at })]);
    assert_eq!(violations, [Violation::Invented { count: 1 }]);
}

/// Leaves out all of the events of the wheel that the brake has taken, but every third; it subscribes anew.
fn with_lazy_brake(queue: Queue) -> Verdict {
    let mut journal = Run::quiet(1_000).journal();
    let mut taken = 0;
    journal.records.retain_mut(|(node, record)| match &mut record.kind {
        RecordKind::Subscribed { queue: of, .. } if (*node, record.channel) == (brake(), Some(0)) => {
            *of = queue;
            true
        }
        RecordKind::Delivered { .. } if (*node, record.channel) == (brake(), Some(0)) => {
            taken += 1;
            taken % 3 == 0
        }
        _ => true,
    });
    Verdict::of(&journal)
}

#[test]
fn what_the_latest_event_has_replaced_need_not_be_seen() {
    let verdict = with_lazy_brake(Queue::Latest);
    assert_eq!(verdict.violations, []);
    let verdict = with_lazy_brake(Queue::Fifo(16));
    let missing =
        |it: &Violation| matches!(it, Violation::NotDelivered { subscriber, .. } if *subscriber == brake());
    assert!(
        verdict.violations.len() > 20 && verdict.violations.iter().all(missing),
        "{:?}",
        verdict.violations
    );
}

#[test]
fn who_has_not_subscribed_need_not_be_served() {
    let mut journal = Run::quiet(1_000).journal();
    journal.records.retain(|(node, record)| {
        let of_wheel = (*node, record.channel) == (brake(), Some(0));
        !(of_wheel && matches!(record.kind, RecordKind::Subscribed { .. } | RecordKind::Delivered { .. }))
    });
    assert_eq!(Verdict::of(&journal).violations, []);
}

/// All events have the same content: then only their order tells them apart.
#[test]
fn contents_tell_the_judge_nothing() {
    let faults = FaultModel::seeded(11).with_inversion(Chance::new(0.03).unwrap());
    let mut journal = Run { faults, load_interval: 180, ..Run::quiet(1_000) }.journal();
    let before = Verdict::of(&journal);
    for (_, record) in &mut journal.records {
        match &mut record.kind {
            RecordKind::Published { digest, len } => (*digest, *len) = (event(0), 0),
            RecordKind::Delivered { digest, .. } => *digest = event(0),
            _ => {}
        }
    }
    let after = Verdict::of(&journal);
    assert!(after.is_passed(), "{}", summary(&journal, &after));
    assert_eq!(before.totals, after.totals);
    let deviations = [before, after].map(|verdict| verdict.slots.deviation);
    assert_eq!(deviations[0], deviations[1]);
}

#[test]
fn a_delivery_off_its_instant_is_found() {
    let mut journal = Run::quiet(1_000).journal();
    for (node, record) in &mut journal.records {
        if let RecordKind::Delivered { digest, visible_at, .. } = &mut record.kind
            && (*digest, *node, record.channel) == (event(90), brake(), Some(0))
        {
            *visible_at = visible_at.offset_by(90_000);
        }
    }
    let verdict = Verdict::of(&journal);
    let [Violation::OffInstant { off, .. }] = verdict.violations.as_slice() else {
        panic!("{:?}", verdict.violations);
    };
    assert!((85.0..105.0).contains(&off.as_micros()), "{off}");
}

#[test]
fn a_run_that_ends_before_the_clocks_agree_does_not_pass() {
    let verdict = Verdict::of(&Run::quiet(250).journal());
    let [Violation::NothingJudged { destroyed: (few, attempts) }] = verdict.violations.as_slice() else {
        panic!("{:?}", verdict.violations);
    };
    assert!(few * 2 < *attempts, "{few} of {attempts}");
    let text = verdict.violations[0].describe(&EXAMPLE);
    assert!(text.contains("longer (--seconds)"), "{text}");
}

#[test]
fn tables_fit_their_width() {
    let faults = FaultModel::seeded(11).with_inversion(Chance::new(0.02).unwrap());
    let journal = Run { faults, load_interval: 120, ..Run::quiet(1_500) }.journal();
    let text = summary(&journal, &Verdict::of(&journal));
    println!("{text}");
    for line in text.lines() {
        assert!(line.chars().count() <= WIDTH, "{} columns: {line}", line.chars().count());
    }
    assert!(!text.contains('\x1b'));
}

#[test]
fn tables_follow_names_of_any_length() {
    let journal = Run::quiet(1_000).journal();
    let mut report = Report::of(SETTINGS, &journal, &Verdict::of(&journal));
    report.channels[1].name = "temperature of the left front wheel";
    report.channels[1].subscribers[0].node = "body controller";
    let text = Tables { report: &report, style: Style::Plain }.to_string();
    let lines: Vec<_> = text.lines().skip(1).take(2 + report.channels.len()).collect();
    let widths: Vec<_> = lines.iter().map(|line| line.chars().count()).collect();
    assert_eq!(widths, vec![97 + 35 - 11 + 15 - 11; lines.len()], "{text}");
    let long = lines.iter().find(|line| line.contains("left front")).unwrap();
    let place = |line: &str, word: &str| line.find(word).unwrap();
    assert_eq!(place(lines[0], "class"), place(long, "SRT"), "{text}");
    assert_eq!(place(lines[0], "subscriber"), place(long, "body controller"), "{text}");
}

#[test]
fn one_is_no_plural() {
    let journal = Run::quiet(1_000).journal();
    let mut verdict = Verdict::of(&journal);
    verdict.violations = vec![
        Violation::RecordsLost { node: brake(), count: 1 },
        Violation::Invented { count: 1 },
        Violation::Unreported { etag: wheel(), node: brake(), what: Loss::Late, lost: 1, reported: 2 },
    ];
    let words: Vec<_> = verdict.violations.iter().map(|it| it.describe(&EXAMPLE)).collect();
    assert_eq!(
        words,
        [
            "brake: 1 record is missing",
            "1 frame or record of an event that nobody published",
            "wheel_speed: 1 event was late, brake was told 2 times",
        ]
    );
    verdict.violations.truncate(1);
    let mut report = Report::of(SETTINGS, &journal, &verdict);
    report.bus.classes[0].frames = 1;
    (report.background.soft_published, report.background.soft_missed) = (1, 1);
    (report.order.contests, report.channels[1].under_way) = (1, 1);
    let text = Tables { report: &report, style: Style::Plain }.to_string();
    for words in [
        "HRT 1 frame ",
        "of 1 SRT event sent (1 missed its deadline",
        "SRT order: 1 time a frame waited",
        "temperature 1 on its way at the end",
        "FAILED: 1 violation.",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn the_picture_shows_the_slot_that_was_hit() {
    let faults = FaultModel::seeded(11).with_inversion(Chance::new(0.03).unwrap());
    let journal = Run { faults, load_interval: 130, ..Run::quiet(3_000) }.journal();
    let verdict = Verdict::of(&journal);
    let picture = picture::draw(&SETTINGS, &journal, &verdict);
    for text in
        ["ready", "latest start (LST)", "deadline", "delivery", "destroyed", "attempt 2", "retransmission"]
    {
        assert!(picture.contains(text), "{text}");
    }
    if let Some(path) = std::env::var_os("DEMO_PICTURE") {
        std::fs::write(path, &picture).unwrap();
    }
}

/// Two soft events wait; the one that is sent is due later than the other, by this span.
fn contest(other_earlier: Duration) -> Verdict {
    let mut journal = Run::quiet(20).journal();
    let (force, suspension) = (&EXAMPLE.channels[2], &EXAMPLE.channels[3]);
    // The deadlines are 4 ms and 2 ms after publication.
    let late = Instant::from_epoch(Duration::from_millis(10) - other_earlier);
    let early = Instant::from_epoch(Duration::from_millis(8));
    let published = |channel: &Channel, at| {
        let kind = RecordKind::Published { len: 8, digest: Digest::of(&[0; 8]) };
        (channel.publisher, Record { channel: Some(channel.number), at, kind })
    };
    journal.records = vec![published(force, early), published(suspension, late)];
    // Local time is true time.
    let zero = (Instant::EPOCH, at_ms(0));
    let second = (Instant::from_epoch(Duration::from_secs(1)), at_ms(1_000));
    let clock = NodeClock::through(zero, second).unwrap();
    journal.clocks = EXAMPLE.nodes.iter().map(|node| (node.tx_node, clock)).collect();
    let stations: Vec<_> = journal.stations.iter().map(|(_, station)| *station).collect();
    let frame = |channel: &Channel, priority| {
        let id = Id::new(Priority::new(priority), channel.publisher, channel.etag);
        WireFrame::from(Frame::new(id, Payload::full([0; 8])))
    };
    let (winner, loser) = (frame(force, 20), frame(suspension, 21));
    let at = at_ms(10);
    let load = |station, frame| TraceEvent { at, kind: TraceKind::Load { station, mailbox: 1, frame } };
    let start = TraceKind::FrameStart {
        number: 0,
        station: stations[1],
        mailbox: 1,
        frame: winner,
        attempt: 1,
        contenders: 2,
    };
    journal.bus = BusLog::default();
    for event in [load(stations[1], winner), load(stations[2], loser), TraceEvent { at, kind: start }] {
        journal.bus.take(&event);
    }
    Verdict::of(&journal)
}

#[test]
fn a_soft_event_that_overtakes_a_more_urgent_one_is_found() {
    let order = contest(Duration::from_micros(320)).order;
    assert_eq!((order.contests, order.inversions.len()), (1, 0), "{order:?}");
    let order = contest(Duration::from_micros(330)).order;
    assert_eq!((order.contests, order.inversions.len()), (1, 1), "{order:?}");
    assert_eq!(order.inversions[0].by.as_nanos(), 330_000);
}
