//! Reassembly on any frames, and in between a message that is sent whole: it arrives as it was sent.
#![no_main]

use cosmic_core::can::{Etag, Frame, Id, Priority, TxNode};
use cosmic_core::network::fragments::{Fragmenter, Reassembler};
use cosmic_core::time::Duration;
use cosmic_core_fuzz::{Act, Script, check_wakeup};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut script = Script::new(bytes);
    let mut receiver = Reassembler::<3, 40>::new(Duration::from_secs(1));
    let mut sender = Fragmenter::<40>::new();
    let id = Id::new(Priority::LEAST, TxNode::MAX, Etag::BOUND_LAST);
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            // Not from the sender below, and from so few others that there is room for it.
            Act::Frame(frame) => {
                let other = TxNode::new(frame.id.tx_node().get() % 2).unwrap();
                let frame = Frame::new(Id::new(Priority::LEAST, other, Etag::BOUND_LAST), frame.payload);
                if let Some(message) = receiver.on_frame(&frame, now) {
                    assert!(message.content.len() <= 40);
                }
            }
            Act::Call(len, value) => {
                let content = [value; 40];
                let content = &content[..usize::from(len) % 41];
                // A message like the one before may be taken for a repetition of it.
                receiver.on_time(now);
                sender.start(content).unwrap();
                let mut arrived = None;
                while let Some(payload) = sender.poll() {
                    sender.on_sent();
                    let message = receiver.on_frame(&Frame::new(id, payload), now);
                    arrived = message.map(|message| message.content.to_vec());
                }
                assert_eq!(arrived.as_deref(), Some(content));
            }
            Act::Pause => receiver.on_time(now),
        }
        check_wakeup(now, receiver.next_wakeup());
    }
});
