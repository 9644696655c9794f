//! Messages of several frames, on the channel of the rover that carries such.

mod bed;

use bed::{Bed, instant, plan_of};
use cosmic_core::can::Frame;
use cosmic_core::time::Instant;
use cosmic_monitor::{Decoded, Meaning, MessagesView, Monitor};

/// What the monitor says of each frame of the log that is on the journal, without those for which `drops` is true.
fn journal(drops: impl Fn(usize) -> bool) -> (Monitor, Vec<Option<Decoded>>, Instant) {
    let mut bed = Bed::rover().power_on();
    bed.run(5_000);
    let mut monitor = Monitor::with_plan(plan_of(bed::ROVER), Instant::EPOCH);
    let etag = bed.monitor.etag_called("journal").unwrap();
    let (mut told, mut number) = (Vec::new(), 0);
    for (at, wire) in &bed.log {
        let frame = Frame::try_from(*wire).unwrap();
        if frame.id.etag() == etag {
            number += 1;
            if drops(number - 1) {
                continue;
            }
        }
        monitor.on_frame(&frame, instant(*at));
        if frame.id.etag() == etag {
            told.push(monitor.decode_whole(&frame));
        }
    }
    (monitor, told, bed.now())
}

#[test]
fn the_last_frame_of_a_message_is_the_whole_message() {
    let (mut monitor, told, now) = journal(|_| false);
    let whole: Vec<&Decoded> = told.iter().flatten().collect();
    assert_eq!(whole.len(), 3, "one in two seconds");
    assert!(told.len() > 3 * whole.len() && told[0].is_none() && told.last().unwrap().is_some());
    let Meaning::Event { fields, malformed: None } = &whole[0].meaning else { panic!("{:?}", whole[0]) };
    let names: Vec<_> = fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names[..3], ["at", "latitude", "longitude"]);
    assert_eq!((whole[0].channel.as_deref(), whole[0].node.as_deref()), (Some("journal"), Some("base")));
    let snapshot = monitor.snapshot(now);
    assert_eq!(snapshot.messages, MessagesView { whole: 3, ..MessagesView::default() });
    let channel = snapshot.channels.iter().find(|it| it.name.as_deref() == Some("journal")).unwrap();
    let last = channel.last.as_ref().unwrap();
    assert_eq!((&last.data, &last.fields), (&whole[2].data, fields));
}

#[test]
fn a_message_with_a_gap_is_counted_and_not_shown() {
    let (mut monitor, told, now) = journal(|number| number == 2);
    assert_eq!(told.iter().flatten().count(), 2);
    let messages = monitor.snapshot(now).messages;
    assert_eq!((messages.whole, messages.dropped), (2, 1), "{messages:?}");
}

#[test]
fn a_message_whose_beginning_was_not_heard_leaves_stray_frames() {
    let (mut monitor, told, now) = journal(|number| number == 0);
    assert_eq!(told.iter().flatten().count(), 2);
    let messages = monitor.snapshot(now).messages;
    assert!(messages.dropped == 0 && messages.stray_frames > 0, "{messages:?}");
}

#[test]
fn other_frames_are_what_they_are() {
    let mut bed = Bed::rover().power_on();
    bed.run(1_000);
    let journal = bed.monitor.etag_called("journal").unwrap();
    for (at, wire) in bed.log.clone() {
        let frame = Frame::try_from(wire).unwrap();
        bed.monitor.on_frame(&frame, instant(at));
        if frame.id.etag() != journal {
            assert_eq!(bed.monitor.decode_whole(&frame), Some(bed.monitor.decode(&frame)));
        }
    }
}
