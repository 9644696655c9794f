//! Every decoder on any frame; what is decoded survives the way to the wire and back.
#![no_main]

use cosmic_core::can::{Frame, Id, Payload};
use cosmic_core::protocol::{ControlMessage, FollowUp, SyncMessage, names_its_sender};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((raw, data)) = bytes.split_first_chunk::<4>() else { return };
    let Some(id) = Id::from_raw(u32::from_be_bytes(*raw) & 0x1FFF_FFFF) else { return };
    let Some(payload) = Payload::new(&data[..data.len().min(8)]) else { return };
    let frame = Frame::new(id, payload);
    let _ = names_its_sender(id);
    if let Some(message) = ControlMessage::decode(&frame) {
        assert_eq!(ControlMessage::decode(&message.encode()), Some(message));
    }
    if let Some(message) = SyncMessage::decode(&frame) {
        assert_eq!(SyncMessage::decode(&message.encode(id.tx_node())), Some(message));
    }
    if let Some(message) = FollowUp::decode(&frame) {
        assert_eq!(FollowUp::decode(&message.encode(id.tx_node())), Some(message));
    }
});
