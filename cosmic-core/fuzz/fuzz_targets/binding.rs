//! The binding client on any frames and calls.
#![no_main]

use cosmic_core::can::Etag;
use cosmic_core::client::{Binding, BindingEvent, BindingTiming};
use cosmic_core::protocol::Output;
use cosmic_core_fuzz::{Act, Script, check_wakeup, drain, subject, tx_node};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut client = Binding::<3>::new(0, &BindingTiming::DEFAULT);
    let mut script = Script::new(bytes);
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => client.on_frame(&frame, now),
            Act::Call(0..=9, of) => _ = client.bind(subject(of)),
            Act::Call(10..=19, of) => client.set_tx_node(tx_node(of)),
            Act::Call(20..=24, of) => client.forget(subject(of)),
            Act::Call(25..=29, of) => {
                _ = Etag::new(0x3F00 | u16::from(of)).map(|etag| client.assume(subject(of), etag));
            }
            Act::Call(30..=34, of) => {
                _ = Etag::new(0x3F00 | u16::from(of)).map(|etag| client.fix(subject(of), etag));
            }
            Act::Call(..) | Act::Pause => {}
        }
        drain(
            now,
            || client.poll(now),
            |output| {
                if let Output::Event(
                    BindingEvent::Bound { etag, .. } | BindingEvent::Rebound { new: etag, .. },
                ) = output
                {
                    assert!(etag >= Etag::BOUND_FIRST);
                }
            },
        );
        check_wakeup(now, client.next_wakeup());
    }
});
