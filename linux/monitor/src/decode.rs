//! A frame in words: who sent what on which channel, and what stands in it.

use std::fmt;

use cosmic_bus::TrafficClass;
use cosmic_core::can::{Etag, Frame};
use cosmic_core::protocol::{
    AdmissionRefusal, AdmissionReply, AdmissionRequest, AdmissionVerdict, Answer, Class, ConfigurationReply,
    ControlMessage, FollowUp, Half, NodeState, RefusalReason, Side, SupplyEtag, SyncMessage,
};
use cosmic_core::time::Duration;
use serde::Serialize;

/// A frame in words.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Decoded {
    /// The 29 bits of the identifier, hexadecimal.
    pub id: String,
    /// `HRT`, `SRT` or `NRT`, by the priority.
    pub class: &'static str,
    /// The priority field.
    pub priority: u8,
    /// The TxNode field.
    pub tx_node: u8,
    /// The name of that node in the plan.
    pub node: Option<String>,
    /// The etag field.
    pub etag: u16,
    /// The name of the channel in the plan.
    pub channel: Option<String>,
    /// The subject of the channel, if it is known.
    pub subject: Option<String>,
    /// The bytes, hexadecimal.
    pub data: String,
    /// What they mean.
    pub meaning: Meaning,
}

/// What the bytes of a frame mean.
#[derive(Clone, PartialEq, Serialize, Debug)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Meaning {
    /// A control message.
    Control {
        /// Its name.
        name: &'static str,
        /// Its fields.
        fields: Vec<DecodedField>,
    },
    /// An event, or a frame of a message.
    Event {
        /// Its fields, where the plan describes the content; else empty.
        fields: Vec<DecodedField>,
        /// Why its content could not be read though the plan describes it.
        malformed: Option<String>,
    },
    /// A frame with an etag of the protocol that is no message of it.
    Malformed,
}

/// A field and its value, as text.
#[derive(Clone, PartialEq, Eq, Serialize, Debug)]
pub struct DecodedField {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: String,
    /// The unit of the value.
    pub unit: Option<String>,
}

impl DecodedField {
    fn new(name: &str, value: impl fmt::Display) -> Self {
        Self { name: name.to_owned(), value: value.to_string(), unit: None }
    }
}

impl From<cosmic_plan::contents::Field<'_>> for DecodedField {
    fn from(field: cosmic_plan::contents::Field<'_>) -> Self {
        let unit = field.unit.map(str::to_owned);
        Self { name: field.name.to_owned(), value: field.value.to_string(), unit }
    }
}

impl fmt::Display for DecodedField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.value)?;
        self.unit.as_ref().map_or(Ok(()), |unit| write!(f, " {unit}"))
    }
}

impl fmt::Display for Decoded {
    /// One line: class, priority, node, channel, meaning.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let node = self.node.clone().unwrap_or_else(|| format!("node {:02X}", self.tx_node));
        write!(f, "{} {:3}  {node:<12} ", self.class, self.priority)?;
        let channel = self.channel.as_ref().or(self.subject.as_ref());
        match &self.meaning {
            Meaning::Control { name, fields } => {
                write!(f, "{name}")?;
                fields.iter().try_for_each(|field| write!(f, " {field}"))
            }
            Meaning::Event { fields, malformed } => {
                match channel {
                    Some(channel) => write!(f, "{channel}")?,
                    None => write!(f, "etag {}", self.etag)?,
                }
                match malformed {
                    Some(why) => return write!(f, " {} (malformed: {why})", self.data),
                    None if fields.is_empty() => return write!(f, " {}", self.data),
                    None => {}
                }
                fields.iter().try_for_each(|field| write!(f, " {field}"))
            }
            Meaning::Malformed => write!(f, "no message of etag {}: {}", self.etag, self.data),
        }
    }
}

/// The class of a frame by its priority.
pub(crate) fn class_of(frame: &Frame) -> (TrafficClass, &'static str) {
    let class = TrafficClass::of(&(*frame).into());
    let name = match class {
        TrafficClass::Hard => "HRT",
        TrafficClass::Soft => "SRT",
        TrafficClass::NonRealTime => "NRT",
        TrafficClass::Foreign => "foreign",
    };
    (class, name)
}

/// The control message in a frame, if its etag is one of the protocol's.
pub(crate) fn control(frame: &Frame) -> Option<Meaning> {
    if !frame.id.etag().is_reserved() {
        return None;
    }
    let message = match frame.id.etag() {
        Etag::SYNC => SyncMessage::decode(frame).map(sync),
        Etag::FOLLOW_UP => FollowUp::decode(frame).map(follow_up),
        _ => ControlMessage::decode(frame).map(|message| of_message(&message)),
    };
    Some(match message {
        Some((name, fields)) => Meaning::Control { name, fields },
        None => Meaning::Malformed,
    })
}

type Named = (&'static str, Vec<DecodedField>);

fn sync(message: SyncMessage) -> Named {
    let SyncMessage { sequence, rank, predecessor, accuracy, calendar_digest } = message;
    let fields = vec![
        DecodedField::new("sequence", sequence.get()),
        DecodedField::new("rank", rank.get()),
        DecodedField::new("predecessor", predecessor),
        DecodedField { unit: Some("ns".to_owned()), ..DecodedField::new("accuracy", accuracy.as_ticks()) },
        DecodedField::new("calendar", format_args!("{calendar_digest:08X}")),
    ];
    ("sync", fields)
}

fn follow_up(message: FollowUp) -> Named {
    let at = message.sent_at.since_epoch().as_ticks();
    let at = format!("{}.{:09}", at / 1_000_000_000, at % 1_000_000_000);
    let sent_at = DecodedField { unit: Some("s".to_owned()), ..DecodedField::new("sent_at", at) };
    ("follow-up", vec![DecodedField::new("sequence", message.sequence.get()), sent_at])
}

fn of_message(message: &ControlMessage) -> Named {
    let field = |name: &str, value: &dyn fmt::Display| DecodedField::new(name, value);
    match message {
        ControlMessage::ConfigurationRequest(request) => (
            "configuration request",
            vec![
                field("stage", &request.stage().get()),
                field("nibble", &format_args!("{:X}", request.nibble())),
            ],
        ),
        ControlMessage::ConfigurationReply(reply) => ("configuration reply", configuration_reply(reply)),
        ControlMessage::ConfigurationRefusal(refusal) => {
            ("configuration refusal", vec![field("uid", &refusal.uid)])
        }
        ControlMessage::Release(release) => ("release", vec![field("uid", &release.uid)]),
        ControlMessage::NodeIdentity(identity) => ("node identity", vec![field("uid", &identity.uid)]),
        ControlMessage::Probe(_) => ("probe", Vec::new()),
        ControlMessage::BrokerStatus(status) => ("broker status", vec![field("uid", &status.uid)]),
        ControlMessage::GetEtag(get) => ("get etag", vec![field("subject", &get.subject)]),
        ControlMessage::SupplyEtag(supply) => ("supply etag", supply_etag(supply)),
        ControlMessage::Interest(interest) => (
            "interest",
            vec![
                field("side", &side(interest.side)),
                field("etag", &interest.etag.get()),
                field("class", &class_name(interest.class)),
                DecodedField {
                    unit: Some("s".to_owned()),
                    ..field("lease", &(interest.lease.duration().as_millis() as f64 / 1e3))
                },
                field("layout", &format_args!("{:08X}", interest.layout.get())),
            ],
        ),
        ControlMessage::NodeStatus(status) => (
            "node status",
            vec![
                field("state", &state(status.state)),
                field("started by", &status.reset_cause.name()),
                field("tec", &status.transmit_errors),
                field("rec", &status.receive_errors),
                field("sequence", &status.sequence),
                field("exceptions", &status.exceptions),
                DecodedField {
                    unit: Some("s".to_owned()),
                    ..field("uptime", &status.uptime.duration().as_secs())
                },
            ],
        ),
        ControlMessage::AdmissionRequest(request) => ("admission request", admission_request(request)),
        ControlMessage::AdmissionReply(reply) => ("admission reply", admission_reply(reply)),
    }
}

fn in_ms(name: &str, span: Duration) -> DecodedField {
    DecodedField { unit: Some("ms".to_owned()), ..DecodedField::new(name, span.as_micros() as f64 / 1e3) }
}

fn admission_request(request: &AdmissionRequest) -> Vec<DecodedField> {
    vec![
        DecodedField::new("held", request.held),
        DecodedField::new("number", request.number.get()),
        DecodedField::new("etag", request.etag.get()),
        DecodedField::new("length", request.len),
        in_ms("interval", request.interval.duration()),
        in_ms("tolerance", request.tolerance.duration()),
        in_ms("deadline", request.deadline.duration()),
    ]
}

fn admission_reply(reply: &AdmissionReply) -> Vec<DecodedField> {
    let mut fields = vec![
        DecodedField::new("requester", reply.requester),
        DecodedField::new("number", reply.number.get()),
        DecodedField::new("etag", reply.etag.get()),
    ];
    match reply.verdict {
        AdmissionVerdict::Admitted(lease) => {
            let seconds = lease.duration().as_millis() as f64 / 1e3;
            let lease = DecodedField { unit: Some("s".to_owned()), ..DecodedField::new("lease", seconds) };
            fields.extend([DecodedField::new("admitted", true), lease]);
        }
        AdmissionVerdict::Refused(AdmissionRefusal { reason, fits_at, suffers }) => {
            fields.push(DecodedField::new("refused", refusal(reason)));
            fields.extend(fits_at.map(|interval| in_ms("fits_at", interval.duration())));
            fields.extend(suffers.map(|etag| DecodedField::new("suffers", etag.get())));
        }
    }
    fields
}

fn refusal(reason: RefusalReason) -> &'static str {
    match reason {
        RefusalReason::Utilisation => "utilisation",
        RefusalReason::Blocking => "blocking",
        RefusalReason::Late => "late",
        RefusalReason::OtherLate => "other-late",
        RefusalReason::LessUrgentLate => "less-urgent-late",
        RefusalReason::Full => "table-full",
    }
}

fn configuration_reply(reply: &ConfigurationReply) -> Vec<DecodedField> {
    match reply {
        ConfigurationReply::Prefix(prefix) => {
            vec![DecodedField::new("prefix_of_stage", prefix.stage().get())]
        }
        ConfigurationReply::Assigned { uid, tx_node } => {
            vec![DecodedField::new("uid", uid), DecodedField::new("tx_node", tx_node)]
        }
        ConfigurationReply::Restart => vec![DecodedField::new("restart", true)],
    }
}

fn supply_etag(supply: &SupplyEtag) -> Vec<DecodedField> {
    let answer = match supply.answer() {
        Answer::Bound(etag) => DecodedField::new("etag", etag.get()),
        Answer::Refused => DecodedField::new("refused", true),
    };
    let half = if supply.half() == Half::First { "first" } else { "second" };
    let claim = DecodedField::new("claim", supply.is_claim());
    vec![DecodedField::new("requester", supply.requester()), DecodedField::new("half", half), answer, claim]
}

fn side(side: Side) -> &'static str {
    match side {
        Side::Subscriber => "subscriber",
        Side::Publisher => "publisher",
    }
}

/// What tables and lines call a class: `HRT`, `SRT`, `NRT`.
pub const fn class_name(class: Class) -> &'static str {
    match class {
        Class::Hard => "HRT",
        Class::Soft => "SRT",
        Class::NonRealTime => "NRT",
    }
}

pub(crate) fn state(state: NodeState) -> &'static str {
    match state {
        NodeState::Starting => "starting",
        NodeState::Operational => "operational",
        NodeState::HardInhibited => "hard-inhibited",
        NodeState::Leaving => "leaving",
    }
}
