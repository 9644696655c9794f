//! The control messages, field by field, for tools that show them. Tests hold this table equal to
//! [`cosmic_core::protocol`].

use cosmic_core::can::Etag;

/// A control message.
#[derive(Clone, Copy, Debug)]
pub struct Control {
    /// The etag of its frames.
    pub etag: Etag,
    /// What it is called.
    pub name: &'static str,
    /// Bytes of its data.
    pub len: usize,
    /// The fields of its data.
    pub fields: &'static [ControlField],
}

/// A field of a control message.
#[derive(Clone, Copy, Debug)]
pub struct ControlField {
    /// Its name.
    pub name: &'static str,
    /// Its first bit; bit 0 is the highest of byte 0.
    pub at: usize,
    /// How many bits it has.
    pub bits: usize,
    /// How its number is shown.
    pub shown: Shown,
}

/// How a number is shown.
#[derive(Clone, Copy, Debug)]
pub enum Shown {
    /// In decimal, with a unit.
    Decimal(&'static str),
    /// In hexadecimal.
    Hexadecimal,
    /// By name.
    Names(&'static [(u64, &'static str)]),
}

const fn field(name: &'static str, at: usize, bits: usize, shown: Shown) -> ControlField {
    ControlField { name, at, bits, shown }
}

const UID: &[ControlField] = &[field("uid", 0, 64, Shown::Hexadecimal)];

/// All control messages, by etag. The request of the configuration has its stage and its part of the UID in the
/// identifier.
pub const CONTROL: &[Control] = &[
    Control {
        etag: Etag::CONFIGURATION_REPLY,
        name: "configuration_reply",
        len: 8,
        fields: &[field("uid_or_prefix", 0, 64, Shown::Hexadecimal)],
    },
    Control { etag: Etag::CONFIGURATION_REQUEST, name: "configuration_request", len: 0, fields: &[] },
    Control {
        etag: Etag::GET_ETAG,
        name: "get_etag",
        len: 8,
        fields: &[field("subject", 0, 64, Shown::Hexadecimal)],
    },
    Control {
        etag: Etag::SUPPLY_ETAG,
        name: "supply_etag",
        len: 8,
        fields: &[
            field("requester", 0, 8, Shown::Decimal("")),
            field(
                "answer",
                8,
                8,
                Shown::Names(&[
                    (0, "bound, first half"),
                    (1, "bound, second half"),
                    (2, "refused, first half"),
                    (3, "refused, second half"),
                    (4, "claim, first half"),
                    (5, "claim, second half"),
                ]),
            ),
            field("etag", 16, 16, Shown::Decimal("")),
            field("half_of_subject", 32, 32, Shown::Hexadecimal),
        ],
    },
    Control { etag: Etag::CONFIGURATION_REFUSAL, name: "configuration_refusal", len: 8, fields: UID },
    Control { etag: Etag::RELEASE, name: "release", len: 8, fields: UID },
    Control { etag: Etag::NODE_IDENTITY, name: "node_identity", len: 8, fields: UID },
    Control { etag: Etag::PROBE, name: "probe", len: 0, fields: &[] },
    Control { etag: Etag::BROKER_STATUS, name: "broker_status", len: 8, fields: UID },
    Control {
        etag: Etag::SYNC,
        name: "sync",
        len: 8,
        fields: &[
            field("sequence", 0, 4, Shown::Decimal("")),
            field("rank", 4, 4, Shown::Decimal("")),
            field("predecessor", 8, 8, Shown::Decimal("")),
            field("accuracy", 16, 16, Shown::Decimal("ns")),
            field("calendar_digest", 32, 32, Shown::Hexadecimal),
        ],
    },
    Control {
        etag: Etag::FOLLOW_UP,
        name: "follow_up",
        len: 8,
        fields: &[field("sequence", 0, 4, Shown::Decimal("")), field("sent_at", 4, 60, Shown::Decimal("ns"))],
    },
    Control {
        etag: Etag::INTEREST,
        name: "interest",
        len: 8,
        fields: &[
            field("side", 0, 1, Shown::Names(&[(0, "subscribes"), (1, "announces")])),
            field("etag", 2, 14, Shown::Decimal("")),
            field("class", 16, 2, Shown::Names(&[(0, "HRT"), (1, "SRT"), (2, "NRT")])),
            field("lease", 18, 14, Shown::Decimal("x 0.1 s")),
            field("layout", 32, 32, Shown::Hexadecimal),
        ],
    },
    Control {
        etag: Etag::NODE_STATUS,
        name: "node_status",
        len: 8,
        fields: &[
            field(
                "state",
                0,
                8,
                Shown::Names(&[(0, "starting"), (1, "operational"), (2, "HRT inhibited"), (3, "leaving")]),
            ),
            field("transmit_errors", 8, 8, Shown::Decimal("")),
            field("receive_errors", 16, 8, Shown::Decimal("")),
            field("sequence", 24, 8, Shown::Decimal("")),
            field("exceptions", 32, 16, Shown::Decimal("")),
            field("uptime", 48, 16, Shown::Decimal("s")),
        ],
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Frame, Id, Payload, Priority, TxNode};
    use cosmic_core::protocol::{ControlMessage, FollowUp, SyncMessage};

    fn read(message: &Control, bytes: [u8; 8], name: &str) -> u64 {
        let field = message.fields.iter().find(|field| field.name == name).unwrap();
        u64::from_be_bytes(bytes) << field.at >> (64 - field.bits)
    }

    fn described(etag: Etag) -> Option<&'static Control> {
        CONTROL.iter().find(|control| control.etag == etag)
    }

    /// Every frame that the core takes for a control message stands in the table, and its fields are where the table
    /// says.
    #[test]
    fn the_table_is_what_the_core_decodes() {
        let mut seed = 0x1234_5678_9ABC_DEF1_u64;
        let mut next = || {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            seed
        };
        let mut met = Vec::new();
        for round in 0..200_000 {
            let etag = Etag::new(next() as u16 % 100).unwrap();
            let tx_node = TxNode::new(next() as u8 % 128).unwrap();
            let mut bytes = next().to_be_bytes();
            // Small numbers are met more often, where a byte says which kind it is.
            bytes[0] %= [4, 255][round % 2];
            bytes[1] %= [6, 255][round % 2];
            let payload = if round % 5 == 0 { Payload::EMPTY } else { Payload::full(bytes) };
            let priority =
                if etag.get() == 1 { Priority::new(250 + round as u8 % 2) } else { Priority::CONFIGURATION };
            let frame = Frame::new(Id::new(priority, tx_node, etag), payload);
            let is_sync = SyncMessage::decode(&frame).is_some() || FollowUp::decode(&frame).is_some();
            let message = ControlMessage::decode(&frame);
            if message.is_none() && !is_sync {
                continue;
            }
            let control = described(etag).unwrap_or_else(|| panic!("{message:?} is not in the table"));
            assert_eq!(control.len, payload.len(), "{message:?}");
            if !met.contains(&etag) {
                met.push(etag);
            }
            let field = |name: &str| read(control, bytes, name);
            match message {
                Some(ControlMessage::NodeStatus(status)) => {
                    assert_eq!(field("state"), status.state as u64);
                    assert_eq!(field("transmit_errors"), u64::from(status.transmit_errors));
                    assert_eq!(field("receive_errors"), u64::from(status.receive_errors));
                    assert_eq!(field("sequence"), u64::from(status.sequence));
                    assert_eq!(field("exceptions"), u64::from(status.exceptions));
                    assert_eq!(field("uptime"), status.uptime.duration().as_secs());
                }
                Some(ControlMessage::Interest(interest)) => {
                    assert_eq!(field("side"), interest.side as u64);
                    assert_eq!(field("etag"), u64::from(interest.etag.get()));
                    assert_eq!(field("class"), interest.class as u64);
                    assert_eq!(field("lease") * 100, interest.lease.duration().as_millis());
                    assert_eq!(field("layout"), u64::from(interest.layout.get()));
                }
                Some(ControlMessage::NodeIdentity(identity)) => assert_eq!(field("uid"), identity.uid.get()),
                Some(ControlMessage::GetEtag(get)) => assert_eq!(field("subject"), get.subject.get()),
                _ => {}
            }
            if let Some(sync) = SyncMessage::decode(&frame) {
                assert_eq!(field("sequence"), u64::from(sync.sequence.get()));
                assert_eq!(field("rank"), u64::from(sync.rank.get()));
                assert_eq!(field("accuracy"), sync.accuracy.as_ticks());
                assert_eq!(field("calendar_digest"), u64::from(sync.calendar_digest));
            }
            if let Some(follow_up) = FollowUp::decode(&frame) {
                assert_eq!(field("sent_at"), follow_up.sent_at.since_epoch().as_ticks());
            }
        }
        for control in CONTROL {
            assert!(met.contains(&control.etag), "{} was not met", control.name);
        }
    }
}
