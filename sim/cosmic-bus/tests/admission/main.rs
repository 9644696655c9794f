//! Channels that the plan does not know, in whole clusters: asked for, admitted, refused, held over fail-over, cuts, lost
//! frames and hostile questions.

use cosmic_bus::{Chance, FaultModel};
use cosmic_core::Subject;
use cosmic_core::admission::AdmissionTiming;
use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::client::AdmissionState;
use cosmic_core::event_layer::{
    AnnounceError, Channel, EventRate, ExceptionKind, PublishError, SoftAttributes,
};
use cosmic_core::protocol::{AdmissionReply, AdmissionVerdict, AskNumber, RefusalReason};
use cosmic_core::time::Duration;

mod bed;

use bed::{ADMITTED, ASK, Bed, NON_REAL_TIME, REFUSE, Stranger, channel, question, us};

#[test]
fn a_channel_is_published_when_it_is_admitted_and_frees_its_place_when_it_is_given_up() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    // A broker that has just started first hears what is held.
    bed.run(1_000);
    assert_eq!(bed.state(3, 0xB), Some(AdmissionState::Waiting));
    bed.run(1_500);
    assert!(bed.is_admitted(3, 0xB));
    let refused = bed.refused(3, 0xB);
    assert!(refused.contains(&PublishError::NotBound) && refused.contains(&PublishError::NotAdmitted));
    // Now an answer takes milliseconds.
    bed.announce(4, channel(0xC, us(10_000), us(5_000))).unwrap();
    bed.run(20);
    assert!(bed.is_admitted(4, 0xC));
    assert_eq!(bed.table(), [3, 4]);
    bed.forget_refusals();
    // Beyond the lease, which is renewed.
    bed.run(25_000);
    assert_eq!(bed.table(), [3, 4]);
    assert!(bed.taken(3, 0xB) > 2_400 && bed.refused(3, 0xB).is_empty());
    bed.cancel(3, 0xB);
    bed.run(20);
    assert_eq!(bed.table(), [4]);
    bed.none_was_late();
}

#[test]
fn a_refusal_says_why_and_what_would_fit() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    bed.run(2_500);
    bed.announce(3, channel(0xB, us(150), us(2_000))).unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(3, 0xB) else { panic!("{:?}", bed.state(3, 0xB)) };
    assert_eq!(refusal.reason, RefusalReason::Utilisation);
    assert_eq!(bed.taken(3, 0xB), 0);
    assert!(bed.journal.borrow().exceptions.contains(&(3, ExceptionKind::NotAdmitted)));
    // What is said to fit fits.
    let interval = refusal.fits_at.unwrap().duration();
    bed.cancel(3, 0xB);
    bed.announce(3, channel(0xB, interval, us(2_000))).unwrap();
    bed.run(100);
    assert!(bed.is_admitted(3, 0xB));
    // Another whose deadline is shorter than the frame that may be before it; and one that makes the first late.
    bed.announce(4, channel(0xC, us(50_000), us(200))).unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(4, 0xC) else { panic!("it is refused") };
    assert_eq!((refusal.reason, refusal.fits_at), (RefusalReason::Blocking, None));
    bed.announce(
        4,
        channel(0xD, us(100_000), us(1_000)).with_rate(EventRate::sporadic(us(100_000)).with_burst(12)),
    )
    .unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(4, 0xD) else { panic!("it is refused") };
    assert!(matches!(refusal.reason, RefusalReason::Late | RefusalReason::OtherLate), "{refusal:?}");
    bed.none_was_late();
}

#[test]
fn what_states_no_rate_or_is_out_of_range_cannot_be_asked_for() {
    let mut bed = Bed::new(3, 1, &ASK, FaultModel::none());
    let attributes = SoftAttributes { deadline: us(5_000), validity: us(5_000) };
    let plain: Channel<u64> = Channel::soft(Subject::new(0xB).unwrap(), attributes);
    assert_eq!(bed.announce(3, plain), Err(AnnounceError::NoRate));
    let jumpy =
        plain.with_rate(EventRate::sporadic(us(5_000)).with_jitter(Duration::from_secs(3600 * 24 * 30)));
    assert_eq!(bed.announce(3, jumpy), Err(AnnounceError::NotAskable));
    // It did not stay behind.
    bed.announce(3, channel(0xB, us(5_000), us(5_000))).unwrap();
}

#[test]
fn what_was_admitted_outlives_the_broker() {
    let mut bed = Bed::new(6, 2, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(1));
    // The lease passes, and the standby is broker now.
    bed.run(12_000);
    bed.all_three_go_on();
    bed.a_fourth_is_refused();
    // The first comes back: one of the two stays.
    bed.cluster.power_on(bed.station(1));
    bed.run(12_000);
    bed.all_three_go_on_but_for_refused_fourth();
}

#[test]
fn a_broker_that_restarts_at_once_learns_what_is_held_before_it_admits_more() {
    for pause in [5, 100, 700] {
        let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
        bed.with_three_admitted();
        bed.cluster.power_off(bed.station(1));
        bed.run(pause);
        bed.cluster.power_on(bed.station(1));
        bed.run(5);
        bed.announce(6, channel(6, us(500), us(3_000))).unwrap();
        bed.run(12_000);
        assert!(matches!(bed.state(6, 6), Some(AdmissionState::Refused(_))), "{:?}", bed.state(6, 6));
        assert_eq!(bed.taken(6, 6), 0, "after a pause of {pause} ms");
        bed.all_three_go_on_but_for_refused_fourth();
    }
}

#[test]
fn without_any_broker_what_was_admitted_goes_on_and_nothing_else_begins() {
    let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(1));
    bed.run(1_500);
    bed.announce(6, channel(6, us(50_000), us(3_000))).unwrap();
    bed.run(30_000);
    for number in 3..=5 {
        assert_eq!(bed.refused(number, number.into()), []);
    }
    assert_eq!((bed.state(6, 6), bed.taken(6, 6)), (Some(AdmissionState::Waiting), 0));
    bed.cancel(6, 6);
    bed.cluster.power_on(bed.station(1));
    bed.run(12_000);
    bed.all_three_go_on_but_for_refused_fourth();
}

#[test]
fn a_node_that_falls_silent_frees_its_place() {
    let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(4));
    bed.run(11_000);
    assert_eq!(bed.table(), [3, 5]);
    bed.announce(6, channel(6, us(600), us(3_000))).unwrap();
    bed.run(300);
    assert!(bed.is_admitted(6, 6));
}

#[test]
fn frames_that_are_lost_cost_time_only() {
    let faults = FaultModel::seeded(9)
        .with_inversion(Chance::new(0.02).unwrap())
        .with_omission(Chance::new(0.02).unwrap());
    let mut bed = Bed::new(6, 2, &ASK, faults);
    bed.run(3_000);
    for number in 3..=5 {
        bed.announce(number, channel(u64::from(number), us(2_000), us(8_000))).unwrap();
    }
    bed.run(2_000);
    bed.forget_refusals();
    bed.cluster.power_off(bed.station(1));
    bed.run(12_000);
    for number in 3..=5 {
        assert!(bed.is_admitted(number, number.into()));
        assert_eq!(bed.refused(number, number.into()), []);
    }
    assert_eq!(bed.table(), [3, 4, 5]);
}

#[test]
fn two_halves_that_admitted_too_much_together_find_out() {
    let mut bed = Bed::new(6, 2, &ASK, FaultModel::none());
    bed.run(2_500);
    // Each half asks while the other is off the bus, and has a broker.
    for number in [2, 5, 6] {
        bed.cluster.disconnect(bed.station(number));
    }
    for number in [3, 4] {
        bed.announce(number, channel(u64::from(number), us(500), us(3_000))).unwrap();
    }
    bed.run(500);
    assert!(bed.is_admitted(3, 3) && bed.is_admitted(4, 4));
    for number in [1, 3, 4] {
        bed.cluster.disconnect(bed.station(number));
    }
    for number in [2, 5, 6] {
        bed.cluster.connect(bed.station(number));
    }
    for number in [5, 6] {
        bed.announce(number, channel(u64::from(number), us(500), us(3_000))).unwrap();
    }
    bed.run(5_000);
    assert!(bed.is_admitted(5, 5) && bed.is_admitted(6, 6));
    for number in [1, 3, 4] {
        bed.cluster.connect(bed.station(number));
    }
    bed.run(8_000);
    let admitted = (3..=6).filter(|number| bed.is_admitted(*number, (*number).into())).count();
    // Three of them fit.
    assert_eq!((admitted, bed.table().len()), (3, 3));
    // From then on none is late.
    bed.journal.borrow_mut().exceptions.clear();
    bed.run(5_000);
    bed.none_was_late();
}

#[test]
fn without_a_broker_the_plan_decides() {
    let mut bed = Bed::new(3, 1, &REFUSE, FaultModel::none());
    assert_eq!(bed.announce(3, channel(0xB, us(5_000), us(5_000))), Err(AnnounceError::OutsidePlan));

    let mut bed = Bed::new(3, 1, &NON_REAL_TIME, FaultModel::none());
    let etag = Etag::new(0x1234).unwrap();
    bed.announce(3, channel(0xB, us(5_000), us(5_000)).with_etag(etag)).unwrap();
    // Its id is claimed first.
    bed.run(100);
    bed.forget_refusals();
    bed.run(1_000);
    assert_eq!(bed.refused(3, 0xB), []);
    let frames = bed.frames(etag);
    assert!(frames.len() > 190 && frames.iter().all(|frame| frame.id.priority().get() == 255));
}

#[test]
fn a_flood_of_questions_is_answered_within_bounds_and_others_are_served() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    let _ = bed.frames(Etag::ADMISSION_REPLY);
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    // Any interval, any channel, from sixteen ids, new or held.
    stranger.flood(&mut bed, 2_000, |turn| {
        let interval = [1, 7, 200, 1_000, 100_000, 1 << 39][turn as usize % 6];
        question(100 + turn as u8 % 16, 1024 + turn as u16 % 97, interval, turn % 3 == 0, turn as u8).encode()
    });
    assert!(bed.is_admitted(3, 0xB), "{:?}", bed.state(3, 0xB));
    let replies = bed.frames(Etag::ADMISSION_REPLY);
    assert!(replies.iter().all(|frame| AdmissionReply::decode(frame).is_some()));
    assert!((10..=420).contains(&replies.len()), "{} replies in two seconds", replies.len());
    assert!(bed.table().len() <= ADMITTED);
    // When it ends, its channels do with their leases.
    bed.run(11_000);
    assert_eq!(bed.table(), [3]);
    bed.none_was_late();
}

#[test]
fn questions_that_no_node_sends_do_not_disturb_others() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    // A frame that has bytes which no message has.
    stranger.flood(&mut bed, 100, |turn| {
        let mut frame = question(50, 1024, 1_000, false, 0).encode();
        let mut bytes = frame.payload.padded();
        bytes[turn as usize % 8] = 0xFF;
        frame = Frame::new(frame.id, cosmic_core::can::Payload::full(bytes));
        frame
    });
    bed.run(500);
    let others: Vec<u8> = bed.table().into_iter().filter(|node| *node != 50).collect();
    assert_eq!(others, []);
    bed.announce(4, channel(0xC, us(10_000), us(5_000))).unwrap();
    bed.run(100);
    assert!(bed.is_admitted(4, 0xC));
}

#[test]
fn false_answers_admit_nothing_that_was_not_asked() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    let lease = AdmissionTiming::DEFAULT.lease;
    let false_answers = |bed: &mut Bed| {
        stranger.flood(bed, 200, |turn| {
            let (etag, number) =
                (Etag::new(1024 + turn as u16 / 8 % 64).unwrap(), AskNumber::new(turn as u8));
            let requester = TxNode::new(3 + (turn / 512 % 2) as u8).unwrap();
            AdmissionReply { requester, etag, number, verdict: AdmissionVerdict::Admitted(lease) }.encode()
        });
    };
    // Every etag and number, to nodes that have asked nothing.
    false_answers(&mut bed);
    assert!((bed.state(3, 0xB), bed.state(4, 0xC)) == (None, None));
    assert_eq!(bed.table(), []);
    // To one that holds its channel, and has no question open.
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    bed.run(100);
    let held = bed.state(3, 0xB);
    assert!(matches!(held, Some(AdmissionState::Admitted(_))));
    false_answers(&mut bed);
    assert_eq!(bed.state(3, 0xB), held, "its lease is no longer than it was");
}
