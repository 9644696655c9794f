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
                "reset_cause",
                0,
                4,
                Shown::Names(&[
                    (0, "unknown"),
                    (1, "power-on"),
                    (2, "brown-out"),
                    (3, "reset pin"),
                    (4, "software"),
                    (5, "watchdog"),
                    (6, "low power"),
                    (7, "crystal"),
                ]),
            ),
            field(
                "state",
                4,
                4,
                Shown::Names(&[(0, "starting"), (1, "operational"), (2, "HRT inhibited"), (3, "leaving")]),
            ),
            field("transmit_errors", 8, 8, Shown::Decimal("")),
            field("receive_errors", 16, 8, Shown::Decimal("")),
            field("sequence", 24, 8, Shown::Decimal("")),
            field("exceptions", 32, 16, Shown::Decimal("")),
            field("uptime", 48, 16, Shown::Decimal("s")),
        ],
    },
    Control {
        etag: Etag::ADMISSION_REQUEST,
        name: "admission_request",
        len: 8,
        fields: &[
            field("held", 0, 1, Shown::Names(&[(0, "asks"), (1, "holds")])),
            field("number", 1, 3, Shown::Decimal("")),
            field("length", 4, 4, Shown::Decimal("bytes")),
            field("etag", 8, 14, Shown::Decimal("")),
            field("interval_exponent", 22, 5, Shown::Decimal("")),
            field("interval_mantissa", 27, 9, Shown::Decimal("")),
            field("tolerance_exponent", 36, 5, Shown::Decimal("")),
            field("tolerance_mantissa", 41, 9, Shown::Decimal("")),
            field("deadline_exponent", 50, 5, Shown::Decimal("")),
            field("deadline_mantissa", 55, 9, Shown::Decimal("")),
        ],
    },
    Control {
        etag: Etag::ADMISSION_REPLY,
        name: "admission_reply",
        len: 8,
        fields: &[
            field("requester", 0, 8, Shown::Decimal("")),
            field("verdict", 8, 4, Shown::Names(VERDICTS)),
            field("number", 13, 3, Shown::Decimal("")),
            field("etag", 16, 16, Shown::Decimal("")),
            field("lease_or_interval", 32, 16, Shown::Decimal("")),
            field("suffers", 48, 16, Shown::Decimal("")),
        ],
    },
];

const VERDICTS: &[(u64, &str)] = &[
    (0, "admitted"),
    (1, "refused: utilisation"),
    (2, "refused: blocking"),
    (3, "refused: late"),
    (4, "refused: another would be late"),
    (5, "refused: a less urgent frame would be late"),
    (6, "refused: table full"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Frame, Id, Payload, Priority, TxNode};
    use cosmic_core::protocol::{
        AdmissionVerdict, CoarseSpan, ControlMessage, FollowUp, ResetCause, SyncMessage,
    };
    use cosmic_core::time::Duration;

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
            let tx_node = match round % 3 {
                0 => TxNode::BROKER,
                _ => TxNode::new(next() as u8 % 128).unwrap(),
            };
            let mut bytes = next().to_be_bytes();
            // Small numbers are met more often, where a byte says which kind it is.
            bytes[0] %= [4, 255][round % 2];
            bytes[1] %= [6, 255][round % 2];
            if round % 4 == 0 {
                for at in [2, 4, 6] {
                    bytes[at] %= 64;
                }
            }
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
                    // Causes of newer nodes are unknown.
                    let cause = u8::try_from(field("reset_cause")).unwrap();
                    assert_eq!(ResetCause::numbered(cause), status.reset_cause);
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
                Some(ControlMessage::AdmissionRequest(request)) => {
                    assert_eq!(field("held") == 1, request.held);
                    assert_eq!(field("number"), u64::from(request.number.get()));
                    assert_eq!(field("length"), u64::from(request.len));
                    assert_eq!(field("etag"), u64::from(request.etag.get()));
                    let span = |name: &str| {
                        let part = |of: &str| field(&format!("{name}_{of}"));
                        let us = match part("exponent") {
                            0 => part("mantissa"),
                            exponent => (512 + part("mantissa")) << (exponent - 1),
                        };
                        CoarseSpan::floor(Duration::from_micros(us))
                    };
                    assert_eq!(span("interval"), request.interval);
                    assert_eq!(span("tolerance"), request.tolerance);
                    assert_eq!(span("deadline"), request.deadline);
                }
                Some(ControlMessage::AdmissionReply(reply)) => {
                    assert_eq!(field("requester"), u64::from(reply.requester.get()));
                    assert_eq!(field("number"), u64::from(reply.number.get()));
                    assert_eq!(field("etag"), u64::from(reply.etag.get()));
                    match reply.verdict {
                        AdmissionVerdict::Admitted(lease) => {
                            assert_eq!(field("verdict"), 0);
                            assert_eq!(field("lease_or_interval") * 100, lease.duration().as_millis());
                        }
                        AdmissionVerdict::Refused(refusal) => {
                            assert_eq!(field("verdict"), refusal.reason as u64);
                            let suffers = refusal.suffers.map_or(0, |etag| etag.get());
                            assert_eq!(field("suffers"), u64::from(suffers));
                        }
                    }
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
