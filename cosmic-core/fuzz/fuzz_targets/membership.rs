//! Liveness, interests and declarations on any frames and calls.
#![no_main]

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::membership::{Declarations, Health, Interests, Members, StatusReport};
use cosmic_core::protocol::{Class, LayoutHash, Lease, NodeState, Side};
use cosmic_core::time::Duration;
use cosmic_core_fuzz::{Act, Script, check_wakeup, drain, tx_node};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut script = Script::new(bytes);
    let mut members = Members::<3>::new(Duration::from_secs(3));
    let mut interests = Interests::<4>::new();
    let mut declarations = Declarations::<3>::new(Lease::MIN);
    let mut report = StatusReport::new(script.now, Duration::from_secs(1));
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => {
                let _ = members.on_frame(&frame, now);
                let _ = interests.on_frame(&frame, now);
                let _ = declarations.on_frame(&frame, now);
            }
            Act::Call(0..=9, of) => declarations.set_tx_node(now, tx_node(of)),
            Act::Call(10..=19, of) => {
                let (etag, layout) = (Etag::new(of.into()).unwrap(), LayoutHash::new(of.into()));
                let _ = declarations.declare(now, etag, Side::Publisher, Class::Soft, layout);
            }
            Act::Call(20..=29, of) => {
                declarations.withdraw(now, Etag::new(of.into()).unwrap(), Side::Publisher);
            }
            Act::Call(_, of) => {
                let health = Health {
                    state: NodeState::Operational,
                    transmit_errors: of,
                    receive_errors: of,
                    exceptions: 0,
                };
                let _ = report.poll(now, TxNode::MIN, &health);
                assert!(report.next_wakeup() > now);
            }
            Act::Pause => {}
        }
        drain(now, || members.poll(now), |_| {});
        drain(now, || interests.poll(now), |_| {});
        drain(now, || declarations.poll(now), |_| {});
        check_wakeup(now, members.next_wakeup());
        check_wakeup(now, interests.next_wakeup());
        check_wakeup(now, declarations.next_wakeup());
    }
});
