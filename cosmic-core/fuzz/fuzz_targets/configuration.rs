//! The configuration client on any frames.
#![no_main]

use cosmic_core::client::{Configuration, ConfigurationEvent, ConfigurationTiming};
use cosmic_core::protocol::Output;
use cosmic_core_fuzz::{Act, Script, check_wakeup, drain, tx_node, uid};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let mut script = Script::new(bytes);
    let timing = &ConfigurationTiming::DEFAULT;
    let mut client = match tx_node(*first) {
        Some(id) if *first % 2 == 0 => Configuration::fixed(script.now, uid(*first), id, 0, timing),
        _ => Configuration::new(script.now, uid(*first), 0, timing),
    };
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => client.on_frame(&frame, now),
            Act::Call(0, _) => client.release(),
            Act::Call(..) | Act::Pause => {}
        }
        // The node knows from the events alone whether it has an id.
        drain(
            now,
            || client.poll(now),
            |output| {
                if let Output::Event(ConfigurationEvent::Configured(id)) = output {
                    assert!(tx_node(id.get()).is_some(), "{id:?} is the broker's");
                }
            },
        );
        check_wakeup(now, client.next_wakeup());
    }
});
