use super::*;
use crate::can::{Etag, Frame, Id, Priority, TxNode};
use crate::time::{Duration, Instant};
use proptest::prelude::*;
use std::vec::Vec;

const TIME_OUT: Duration = Duration::from_millis(500);

fn at(milliseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_millis(milliseconds))
}

fn id(publisher: u8, etag: u16) -> Id {
    Id::new(Priority::LEAST, TxNode::new(publisher).unwrap(), Etag::new(etag).unwrap())
}

#[test]
fn a_message_has_so_many_frames_and_begins_with_the_first() {
    for len in [0, 1, 7, 8, 12, 13, 100, MAX_MESSAGE_LEN] {
        let mut fragmenter = Fragmenter::<MAX_MESSAGE_LEN>::new();
        fragmenter.start(&[1; MAX_MESSAGE_LEN][..len]).unwrap();
        let fragments = core::iter::from_fn(|| fragmenter.poll().inspect(|_| fragmenter.on_sent()));
        let first: Vec<_> = fragments.map(|fragment| begins(&fragment)).collect();
        assert_eq!(first.len(), frames_of(len), "{len}");
        assert!(first[0] && !first[1..].contains(&true), "{len}");
    }
}

fn frame(publisher: u8, bytes: &[u8]) -> Frame {
    Frame::new(id(publisher, 2_000), Payload::new(bytes).unwrap())
}

/// All frames of a message.
fn fragments<const LEN: usize>(sender: &mut Fragmenter<LEN>, content: &[u8]) -> Vec<Payload> {
    sender.start(content).unwrap();
    core::iter::from_fn(|| {
        let payload = sender.poll()?;
        assert_eq!(sender.poll(), None, "one frame at a time");
        sender.on_sent();
        Some(payload)
    })
    .collect()
}

fn frames(publisher: u8, content: &[u8]) -> Vec<Frame> {
    let payloads = fragments(&mut Fragmenter::<200>::new(), content);
    payloads.into_iter().map(|payload| Frame::new(id(publisher, 2_000), payload)).collect()
}

fn receive<const PLACES: usize, const LEN: usize>(
    receiver: &mut Reassembler<PLACES, LEN>,
    frames: &[Frame],
) -> Vec<Vec<u8>> {
    let messages = frames
        .iter()
        .filter_map(|frame| receiver.on_frame(frame, at(0)).map(|message| message.content.to_vec()));
    messages.collect()
}

#[test]
fn literal_frames() {
    let mut sender = Fragmenter::<20>::new();
    let short = fragments(&mut sender, &[1, 2, 3]);
    assert_eq!(short, [Payload::new(&[0xC0, 1, 2, 3]).unwrap()]);
    // CRC-16/IBM-3740 of "123456789" is 0x29B1.
    let long = fragments(&mut sender, b"123456789");
    let expected: [&[u8]; 2] = [b"\x901234567", b"\x5189\x29\xB1"];
    assert_eq!(long, expected.map(|bytes| Payload::new(bytes).unwrap()));
    let empty = fragments(&mut sender, &[]);
    assert_eq!(empty, [Payload::new(&[0xE0]).unwrap()]);
}

#[test]
fn the_crc_may_be_cut_in_two() {
    let content = [0x55; 13];
    let payloads = fragments(&mut Fragmenter::<13>::new(), &content);
    assert_eq!(payloads.iter().map(Payload::len).collect::<Vec<_>>(), [8, 8, 2]);
    let mut receiver = Reassembler::<1, 13>::new(TIME_OUT);
    assert_eq!(receive(&mut receiver, &frames(1, &content)), [content]);
}

#[test]
fn a_message_that_does_not_fit_is_refused_or_dropped() {
    let mut sender = Fragmenter::<10>::new();
    assert_eq!(sender.start(&[0; 11]), Err(StartError::TooLong));
    sender.start(&[0; 10]).unwrap();
    assert_eq!(sender.start(&[0; 1]), Err(StartError::Busy));
    let mut receiver = Reassembler::<1, 19>::new(TIME_OUT);
    assert_eq!(receive(&mut receiver, &frames(1, &[7; 20])), [[0u8; 0]; 0]);
    assert_eq!((receiver.counters().too_long, receiver.counters().orphans), (1, 0));
    assert_eq!(receive(&mut receiver, &frames(1, &[7; 19])), [[7; 19]]);
    let mut tiny = Reassembler::<1, 4>::new(TIME_OUT);
    assert_eq!(receive(&mut tiny, &frames(1, &[7; 8])), [[0u8; 0]; 0]);
    assert_eq!((tiny.counters().too_long, tiny.counters().delivered), (1, 0));
}

#[test]
fn a_discarded_frame_ends_the_message() {
    let mut sender = Fragmenter::<30>::new();
    sender.start(&[1; 30]).unwrap();
    let first = sender.poll().unwrap();
    sender.on_discarded();
    assert!(sender.is_idle());
    assert_eq!(sender.discarded(), 1);
    assert_eq!(sender.poll(), None);
    let mut receiver = Reassembler::<1, 30>::new(TIME_OUT);
    assert_eq!(receiver.on_frame(&Frame::new(id(1, 2_000), first), at(0)), None);
    // The number of the message tells the next one from the rest of this one.
    let next = fragments(&mut sender, &[2; 30]);
    let next: Vec<_> = next.into_iter().map(|payload| Frame::new(id(1, 2_000), payload)).collect();
    assert_eq!(receive(&mut receiver, &next), [[2; 30]]);
    assert_eq!(receiver.counters().incomplete, 1);
}

#[test]
fn publishers_and_channels_are_told_apart() {
    let mut receiver = Reassembler::<3, 50>::new(TIME_OUT);
    let messages = [frames(1, &[1; 50]), frames(2, &[2; 50])];
    let other: Vec<_> =
        frames(1, &[3; 50]).iter().map(|frame| Frame::new(id(1, 2_001), frame.payload)).collect();
    let mut seen = Vec::new();
    for (number, frame) in messages[0].iter().enumerate() {
        for frame in [frame, &messages[1][number], &other[number]] {
            if let Some(message) = receiver.on_frame(frame, at(0)) {
                seen.push((message.publisher.get(), message.etag.get(), message.content.to_vec()));
            }
        }
    }
    let all = [(1, 2_000, [1; 50].to_vec()), (2, 2_000, [2; 50].to_vec()), (1, 2_001, [3; 50].to_vec())];
    assert_eq!(seen, all);
}

#[test]
fn without_a_free_place_a_message_is_dropped_and_short_ones_are_not() {
    let mut receiver = Reassembler::<1, 50>::new(TIME_OUT);
    let long = frames(1, &[1; 20]);
    assert_eq!(receiver.on_frame(&long[0], at(0)), None);
    assert_eq!(receive(&mut receiver, &frames(2, &[2; 20])), [[0u8; 0]; 0]);
    assert_eq!((receiver.counters().no_room, receiver.counters().orphans), (1, 3));
    assert_eq!(receive(&mut receiver, &frames(3, &[3])), [[3]]);
    assert_eq!(receive(&mut receiver, &long[1..]), [[1; 20]]);
}

#[test]
fn a_message_that_stops_frees_its_place_after_the_time_out() {
    let mut receiver = Reassembler::<1, 50>::new(TIME_OUT);
    let long = frames(1, &[1; 20]);
    let _ = receiver.on_frame(&long[0], at(0));
    let _ = receiver.on_frame(&long[1], at(400));
    assert_eq!(receiver.next_wakeup(), at(900));
    receiver.on_time(at(899));
    assert_eq!(receiver.counters().timed_out, 0);
    receiver.on_time(at(900));
    assert_eq!(receiver.counters().timed_out, 1);
    assert_eq!(receiver.next_wakeup(), Instant::FAR_FUTURE);
    assert_eq!(receiver.on_frame(&long[2], at(901)), None);
    assert_eq!(receiver.counters().orphans, 1);
}

#[test]
fn repeated_frames_are_ignored() {
    let mut receiver = Reassembler::<1, 50>::new(TIME_OUT);
    for content in [&[9u8; 40][..], &[9; 3]] {
        let twice: Vec<_> = frames(1, content).iter().flat_map(|frame| [*frame, *frame]).collect();
        assert_eq!(receive(&mut receiver, &twice), [content]);
    }
    // Six frames of the long one, one of the short one.
    assert_eq!(receiver.counters().duplicates, 7);
    // Much later, the same bytes are a new message, of a publisher that has restarted.
    let again = frames(1, &[9; 3]);
    assert!(receiver.on_frame(&again[0], at(10_000)).is_some());
}

#[test]
fn frames_that_cannot_be_are_counted() {
    let mut receiver = Reassembler::<1, 50>::new(TIME_OUT);
    let wrong = [
        frame(1, &[]),
        frame(1, &[0x81, 1, 2, 3, 4, 5, 6, 7]), // first, but number 1
        frame(1, &[0x80, 1, 2]),                // not the last, but not full
        frame(1, &[0x41]),                      // last of several, without CRC
    ];
    assert_eq!(receive(&mut receiver, &wrong), [[0u8; 0]; 0]);
    assert_eq!(receiver.counters().malformed, 4);
}

#[test]
fn a_wrong_concatenation_is_not_delivered() {
    let mut receiver = Reassembler::<1, 200>::new(TIME_OUT);
    let mut long = frames(1, &core::array::from_fn::<u8, 200, _>(|at| at as u8));
    // Sixteen missing frames leave the numbers as they should be.
    long.drain(3..19);
    assert_eq!(receive(&mut receiver, &long), [[0u8; 0]; 0]);
    assert_eq!(receiver.counters().corrupt, 1);
}

proptest! {
    #[test]
    fn any_message_arrives_as_it_was_sent(
        messages in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..=200), 1..8),
    ) {
        let mut sender = Fragmenter::<200>::new();
        let mut receiver = Reassembler::<1, 200>::new(TIME_OUT);
        for content in &messages {
            let payloads = fragments(&mut sender, content);
            let expected = if content.len() <= 7 { 1 } else { (content.len() + 2).div_ceil(7) };
            prop_assert_eq!(payloads.len(), expected);
            let frames: Vec<_> = payloads.into_iter().map(|payload| Frame::new(id(1, 2_000), payload)).collect();
            prop_assert_eq!(receive(&mut receiver, &frames), core::slice::from_ref(content));
        }
        prop_assert_eq!(receiver.counters().delivered as usize, messages.len());
    }

    /// Each publisher sends numbered messages; frames are lost, repeated, and interleaved. What arrives
    /// was sent, in order, once; what does not arrive is counted.
    #[test]
    fn under_faults_messages_arrive_whole_and_once_or_not_at_all(
        lengths in proptest::collection::vec((2usize..=60, 2usize..=60), 1..12),
        faults in proptest::collection::vec(0u8..16, 1..64),
    ) {
        let mut faults = faults.iter().cycle();
        let mut receiver = Reassembler::<2, 60>::new(TIME_OUT);
        let mut senders = [Fragmenter::<60>::new(), Fragmenter::new()];
        let mut delivered = [Vec::new(), Vec::new()];
        let (mut lost, mut repeated) = (0u32, 0u32);
        for (number, lengths) in lengths.iter().enumerate() {
            for (sender, len) in senders.iter_mut().zip([lengths.0, lengths.1]) {
                let mut content = [number as u8 ^ 0x5A; 60];
                content[0] = number as u8;
                sender.start(&content[..len]).unwrap();
            }
            while senders.iter().any(|sender| !sender.is_idle()) {
                for (publisher, sender) in senders.iter_mut().enumerate() {
                    let Some(payload) = sender.poll() else { continue };
                    sender.on_sent();
                    let fault = *faults.next().unwrap();
                    let copies = match fault { 0 => 0, 1 => 2, _ => 1 };
                    lost += u32::from(copies == 0);
                    repeated += u32::from(copies == 2);
                    for _ in 0..copies {
                        let frame = Frame::new(id(publisher as u8, 2_000), payload);
                        if let Some(message) = receiver.on_frame(&frame, at(number as u64)) {
                            delivered[publisher].push(message.content.to_vec());
                        }
                    }
                }
            }
        }
        let mut missing = 0;
        for (publisher, messages) in delivered.iter().enumerate() {
            let mut last = None;
            for content in messages {
                let number = usize::from(content[0]);
                prop_assert!(last < Some(number));
                last = Some(number);
                let sent = [lengths[number].0, lengths[number].1][publisher];
                prop_assert_eq!(content.len(), sent);
                prop_assert!(content[1..].iter().all(|byte| *byte == content[0] ^ 0x5A));
            }
            missing += lengths.len() - messages.len();
        }
        let counters = receiver.counters();
        prop_assert_eq!(lost == 0, missing == 0);
        prop_assert!(counters.duplicates <= repeated);
        prop_assert_eq!(counters.corrupt + counters.malformed + counters.no_room + counters.too_long, 0);
        if lost == 0 {
            prop_assert_eq!((counters.duplicates, counters.orphans), (repeated, 0));
        }
    }

    #[test]
    fn arbitrary_frames_do_no_harm(
        frames in proptest::collection::vec((0u8..3, any::<[u8; 8]>(), 0usize..=8, 0u64..700), 0..200),
    ) {
        let mut receiver = Reassembler::<2, 20>::new(TIME_OUT);
        let mut now = 0;
        for (publisher, mut bytes, len, span) in frames {
            // Numbers that often fit.
            bytes[0] &= 0xC1;
            now += span;
            let frame = Frame::new(id(publisher, 2_000), Payload::truncated(bytes, len));
            if let Some(message) = receiver.on_frame(&frame, at(now)) {
                prop_assert!(message.content.len() <= 20);
            }
        }
    }
}
