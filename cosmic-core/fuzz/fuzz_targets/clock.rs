//! Clock synchronisation on any frames: no instant that a master tells makes it panic, and a node that
//! is not synchronised does not claim to be.
#![no_main]

use cosmic_core::can::{Etag, Frame, Id, TxNode};
use cosmic_core::protocol::Rank;
use cosmic_core::sync::{ClockSync, SyncConfig};
use cosmic_core_fuzz::{Act, Script, check_wakeup, drain, tx_node};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let mut script = Script::new(bytes);
    let config = SyncConfig { rank: Rank::new(*first), ..SyncConfig::DEFAULT };
    let mut clock: ClockSync = ClockSync::new(config, script.now).unwrap();
    clock.set_tx_node(TxNode::new(*first));
    let mut sent = Vec::new();
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => clock.on_frame(&near_sync(&frame), now),
            Act::Call(0..=9, of) => clock.set_tx_node(tx_node(of)),
            Act::Call(..) => {
                if let Some(frame) = sent.pop() {
                    clock.on_sent(&frame, now);
                }
            }
            Act::Pause => {}
        }
        drain(now, || clock.poll(now), |frame| sent.push(frame));
        while clock.poll_event().is_some() {}
        check_wakeup(now, clock.next_wakeup());
        let global = clock.clock();
        let _ = (global.to_local(global.to_global(now)), global.accuracy(now), global.rate_error(now));
    }
});

/// Most frames of the script have some other etag.
fn near_sync(frame: &Frame) -> Frame {
    let etag = if frame.id.etag().get().is_multiple_of(2) { Etag::SYNC } else { Etag::FOLLOW_UP };
    Frame::new(Id::new(frame.id.priority(), frame.id.tx_node(), etag), frame.payload)
}
