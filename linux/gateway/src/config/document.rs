//! From text to configuration.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};

use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{EventRate, Importance};
use cosmic_core::protocol::Class;
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::{ADDRESSES, LinkAddress};
use cosmic_monitor::SegmentPlan;
use cosmic_plan::units;
use serde::Deserialize;
use toml::Spanned;

use super::{ChannelConfig, Config, GATEWAYS, GATEWAYS_NAME, Ip, Mode, Peer, SegmentConfig, Tls};
use crate::keys::Name;
use crate::rules::{Percent, Reach};

/// Something is wrong in a configuration.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Problem {
    /// File and line.
    pub place: String,
    /// What is wrong, and what to write instead.
    pub what: String,
}

/// All that is wrong in a configuration, one line each.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Problems(pub Vec<Problem>);

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, Problem { place, what }) in self.0.iter().enumerate() {
            if at > 0 {
                f.write_str("\n")?;
            }
            write!(f, "{place}: {what}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Problems {}

type Text = Spanned<String>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Document {
    network: Text,
    metrics: Option<Text>,
    #[serde(default)]
    ip: IpTable,
    #[serde(default)]
    segment: Vec<SegmentTable>,
    #[serde(default)]
    channel: Vec<ChannelTable>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct IpTable {
    mode: Option<Text>,
    #[serde(default)]
    listen: Vec<Text>,
    #[serde(default)]
    connect: Vec<Text>,
    tls: Option<TlsTable>,
    #[serde(default)]
    peer: Vec<PeerTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct TlsTable {
    authority: PathBuf,
    certificate: PathBuf,
    key: PathBuf,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct PeerTable {
    certificate: Text,
    segments: Vec<Text>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct SegmentTable {
    name: Text,
    link: Text,
    uid: Option<Text>,
    tx_node: Option<Spanned<i64>>,
    bit_rate: Option<Text>,
    plan: Option<Text>,
    ceiling: Option<Spanned<i64>>,
    broker: Option<Spanned<PathBuf>>,
    #[serde(default)]
    etags: BTreeMap<String, Spanned<i64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct ChannelTable {
    name: Text,
    subject: Text,
    class: Text,
    deadline: Option<Text>,
    validity: Option<Text>,
    importance: Option<Spanned<i64>>,
    interval: Text,
    burst: Option<Spanned<i64>>,
    longest_wait: Option<Text>,
    from: Option<Vec<Text>>,
    to: Option<Vec<Text>>,
    #[serde(default)]
    unasked: Vec<Text>,
}

pub(super) fn read(file: &Path) -> Result<Config, Problems> {
    let name = file.display().to_string();
    let text = std::fs::read_to_string(file).map_err(|error| {
        let what = format!("the file cannot be read: {error}; give the path of a configuration");
        Problems(vec![Problem { place: name.clone(), what }])
    })?;
    parse(&name, &text, file.parent().unwrap_or(Path::new(".")))
}

pub(super) fn parse(file: &str, text: &str, folder: &Path) -> Result<Config, Problems> {
    let mut reader = Reader { file, text, folder, problems: Vec::new() };
    let config = match toml::from_str::<Document>(text) {
        Ok(document) => reader.config(&document),
        Err(error) => {
            let what = error.message().replace('\n', " ");
            let place = error.span().map_or(file.to_owned(), |span| reader.place(span.start));
            reader.problems.push(Problem { place, what: format!("{what}; docs/gateway.md has all fields") });
            None
        }
    };
    match config {
        Some(config) if reader.problems.is_empty() => Ok(config),
        _ => Err(Problems(reader.problems)),
    }
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    folder: &'a Path,
    problems: Vec<Problem>,
}

impl Reader<'_> {
    fn place(&self, at: usize) -> String {
        let before = self.text.get(..at).unwrap_or_default();
        format!("{}:{}", self.file, before.bytes().filter(|byte| *byte == b'\n').count() + 1)
    }

    fn wrong<T>(&mut self, at: &Spanned<T>, field: &str, what: impl fmt::Display) {
        let place = self.place(at.span().start);
        self.problems.push(Problem { place, what: format!("{field}: {what}") });
    }

    /// Reads a value, or notes what is wrong.
    fn value<T, R>(
        &mut self,
        at: &Spanned<T>,
        field: &str,
        read: impl FnOnce(&T) -> Option<R>,
        write: &str,
    ) -> Option<R>
    where
        T: fmt::Debug,
    {
        let value = read(at.get_ref());
        if value.is_none() {
            self.wrong(at, field, format_args!("{:?} is none: {write}", at.get_ref()));
        }
        value
    }

    fn name(&mut self, at: &Text, field: &str) -> Option<Name> {
        self.value(
            at,
            field,
            |text| Name::new(text),
            "write 1 to 32 of a-z, 0-9, '-' and '_', such as \"line-1\"",
        )
    }

    fn span(&mut self, at: Option<&Text>, field: &str) -> Option<Duration> {
        let read = |text: &String| units::parse_span(text).filter(|span| !span.is_zero());
        self.value(at?, field, read, "write a number with its unit: \"10 ms\", \"2.5 s\"")
    }

    fn config(&mut self, document: &Document) -> Option<Config> {
        let network = self.name(&document.network, "network");
        let metrics = document.metrics.as_ref().and_then(|at| {
            self.value(
                at,
                "metrics",
                |text| text.parse().ok(),
                "write an address, such as \"127.0.0.1:9464\"",
            )
        });
        let ip = self.ip(&document.ip);
        let channels: Vec<_> = document.channel.iter().filter_map(|table| self.channel(table)).collect();
        let segments: Vec<_> =
            document.segment.iter().filter_map(|table| self.segment(table, &channels)).collect();
        self.check(document, &segments, &channels);
        Some(Config { network: network?, ip, metrics, segments, channels })
    }

    fn check(&mut self, document: &Document, segments: &[SegmentConfig], channels: &[ChannelConfig]) {
        let (mut names, mut links, mut tables) = (HashSet::new(), HashSet::new(), HashSet::new());
        for table in &document.segment {
            if !names.insert(table.name.get_ref()) {
                self.wrong(&table.name, "name", "another segment has this name: choose another");
            }
            let link = table.link.get_ref().parse::<LinkAddress>().map(|link| link.to_string());
            if link.is_ok_and(|link| !links.insert(link)) {
                self.wrong(&table.link, "link", "another segment has this link: each has a bus of its own");
            }
            if table.broker.as_ref().is_some_and(|broker| !tables.insert(broker.get_ref())) {
                let what = "another segment keeps its table in this file: each needs one of its own";
                self.wrong(&table.name, "broker", what);
            }
        }
        let (mut names, mut subjects) = (HashSet::new(), HashSet::new());
        for table in &document.channel {
            if !names.insert(table.name.get_ref()) {
                self.wrong(&table.name, "name", "another channel has this name: choose another");
            }
            // The number counts, not how it is written.
            if hexadecimal(table.subject.get_ref()).is_some_and(|subject| !subjects.insert(subject)) {
                self.wrong(&table.subject, "subject", "another channel has this subject: state it once");
            }
        }
        if document.channel.len() == channels.len() {
            for (table, channel) in document.channel.iter().zip(channels) {
                self.check_reach(table, channel, segments);
            }
        }
    }

    fn check_reach(&mut self, table: &ChannelTable, channel: &ChannelConfig, segments: &[SegmentConfig]) {
        if channel.class != Class::Hard {
            return;
        }
        for at in table.from.iter().flatten() {
            let segment = segments.iter().find(|it| it.name.as_str() == at.get_ref());
            let planned = |plan: &SegmentPlan| plan.declare(plan.channel_of_subject(channel.subject)?);
            let is_hard = |segment: &SegmentConfig| {
                let planned = segment.plan.as_ref().and_then(planned);
                planned.is_some_and(|planned| planned.attributes().class() == Class::Hard)
            };
            if segment.is_some_and(|segment| !is_hard(segment)) {
                let what = "the plan of this segment has no such hard real-time channel: give the segment its \
                            `plan`, or take the segment out of this list";
                self.wrong(at, "from", what);
            }
        }
        for at in table.to.iter().flatten() {
            if Name::new(at.get_ref()).is_some_and(|name| channel.from.has(&name)) {
                self.wrong(
                    at,
                    "to",
                    "a hard real-time channel cannot enter a segment that it leaves: take it out of one list",
                );
            }
        }
    }

    fn ip(&mut self, table: &IpTable) -> Ip {
        let mode = table.mode.as_ref().and_then(|at| {
            let read = |text: &String| match text.as_str() {
                "router" => Some(Mode::Router),
                "peer" => Some(Mode::Peer),
                "client" => Some(Mode::Client),
                _ => None,
            };
            self.value(at, "mode", read, "write \"router\", \"peer\" or \"client\"")
        });
        let mut endpoints = |list: &[Text], field: &str| -> Vec<String> {
            let is_one = |text: &String| {
                let secret = text.starts_with("tls/");
                let known = secret || text.starts_with("tcp/");
                (known && text.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok()))
                    .then(|| text.clone())
            };
            let write = "write \"tcp/HOST:PORT\" or \"tls/HOST:PORT\"";
            list.iter().filter_map(|at| self.value(at, field, is_one, write)).collect()
        };
        let (listen, connect) = (endpoints(&table.listen, "listen"), endpoints(&table.connect, "connect"));
        let tls = table.tls.as_ref().map(|tls| Tls {
            authority: self.folder.join(&tls.authority),
            certificate: self.folder.join(&tls.certificate),
            key: self.folder.join(&tls.key),
        });
        if tls.is_none() {
            for at in table.listen.iter().chain(&table.connect).filter(|at| at.get_ref().starts_with("tls/"))
            {
                self.wrong(
                    at,
                    "ip",
                    "\"tls/\" needs certificates: add [ip.tls] with authority, certificate and key",
                );
            }
        }
        let mut peers = Vec::new();
        for peer in &table.peer {
            let segments = peer.segments.iter().filter_map(|at| self.name(at, "segments")).collect();
            peers.push(Peer { certificate: peer.certificate.get_ref().clone(), segments });
            if tls.is_none() {
                self.wrong(
                    &peer.certificate,
                    "certificate",
                    "peers are told apart by certificates: add [ip.tls]",
                );
            }
        }
        Ip { mode: mode.unwrap_or_default(), listen, connect, tls, peers }
    }

    fn segment(&mut self, table: &SegmentTable, channels: &[ChannelConfig]) -> Option<SegmentConfig> {
        let name = self.name(&table.name, "name");
        let link = self.value(
            &table.link,
            "link",
            |text| text.parse::<LinkAddress>().ok().filter(|link| !matches!(link, LinkAddress::Log(_))),
            &format!("write {} (a log cannot be published to)", ADDRESSES.replace(" or log:FILE", "")),
        );
        let plan =
            table.plan.as_ref().and_then(|at| match SegmentPlan::read(self.folder.join(at.get_ref())) {
                Ok(plan) => Some(plan),
                Err(refused) => {
                    self.wrong(at, "plan", refused);
                    None
                }
            });
        let uid = match &table.uid {
            Some(at) => self.value(
                at,
                "uid",
                |text| NodeUid::new(hexadecimal(text)?),
                "write up to 16 hexadecimal digits, not zero",
            ),
            None => {
                self.wrong(&table.name, "uid", "it is missing: write the 64-bit name of the gateway's node in this segment, such as uid = \"0x6A7E0001\"");
                None
            }
        };
        let tx_node = table.tx_node.as_ref().and_then(|at| {
            let read = |number: &i64| {
                TxNode::new(u8::try_from(*number).ok()?).filter(|node| *node != TxNode::BROKER)
            };
            self.value(at, "tx-node", read, "write a number from 0 to 126")
        });
        let bit_rate = match (&table.bit_rate, &plan) {
            (Some(at), Some(_)) => {
                self.wrong(at, "bit-rate", "the plan states it: leave it out here");
                None
            }
            (Some(at), None) => {
                let read = |text: &String| BitRate::new(units::parse_bits_per_second(text)?);
                self.value(at, "bit-rate", read, "write a rate from 10 kbit/s to 1 Mbit/s")
            }
            (None, Some(plan)) => Some(plan.bit_rate()),
            (None, None) => Some(BitRate::MAX),
        };
        let ceiling = match &table.ceiling {
            Some(at) => {
                let read = |number: &i64| Percent::new(u8::try_from(*number).ok()?);
                self.value(at, "ceiling", read, "write a share of the bus in percent, 1 to 100")
            }
            None => Some(DEFAULT_CEILING),
        };
        let mut etags: HashMap<_, _> = plan.iter().flat_map(|plan| planned_etags(plan, channels)).collect();
        for (channel, at) in &table.etags {
            let found = channels.iter().find(|it| it.name == *channel).map(|it| it.subject);
            let subject = found.or((channel == GATEWAYS_NAME).then_some(GATEWAYS));
            let Some(subject) = subject else {
                self.wrong(
                    at,
                    "etags",
                    format_args!(
                        "there is no channel {channel:?}: name one of [[channel]], or \"{GATEWAYS_NAME}\""
                    ),
                );
                continue;
            };
            let read = |number: &i64| {
                Etag::new(u16::try_from(*number).ok()?).filter(|etag| !etag.is_hard() && !etag.is_reserved())
            };
            let Some(etag) = self.value(at, "etags", read, "write an etag from 1024 to 16383") else {
                continue;
            };
            if let Some(what) = taken(etag, subject, &etags, plan.as_ref()) {
                self.wrong(at, "etags", what);
            }
            etags.insert(subject, etag);
        }
        let broker = table.broker.as_ref().map(|path| self.folder.join(path.get_ref()));
        if let Some(at) = table.broker.as_ref().filter(|_| table.tx_node.is_none()) {
            self.wrong(at, "broker", "who hosts the broker needs a fixed id: add tx-node");
        }
        Some(SegmentConfig {
            name: name?,
            link: link?,
            uid: uid?,
            tx_node,
            bit_rate: bit_rate?,
            plan,
            ceiling: ceiling?,
            broker,
            etags,
        })
    }

    fn channel(&mut self, table: &ChannelTable) -> Option<ChannelConfig> {
        let subject = self.value(
            &table.subject,
            "subject",
            |text| {
                Subject::new(hexadecimal(text)?)
                    .filter(|subject| *subject != Subject::RESERVED && *subject != GATEWAYS)
            },
            "write up to 16 hexadecimal digits, not zero and none of the middleware's own",
        );
        let class = self.value(
            &table.class,
            "class",
            |text| match text.as_str() {
                "hard" => Some(Class::Hard),
                "soft" => Some(Class::Soft),
                "non-real-time" => Some(Class::NonRealTime),
                _ => None,
            },
            "write \"soft\", \"non-real-time\" or \"hard\"",
        )?;
        let deadline = self.span(table.deadline.as_ref(), "deadline");
        let validity = self.span(table.validity.as_ref(), "validity");
        let longest_wait = self.span(table.longest_wait.as_ref(), "longest-wait");
        let validity = match (class, &table.deadline) {
            (Class::NonRealTime, Some(at)) => {
                self.wrong(at, "deadline", "a non real-time channel has none: leave it out");
                validity
            }
            (Class::NonRealTime, None) => validity,
            (_, None) => {
                self.wrong(&table.class, "deadline", "it is missing: write how long after its publication an event is to be sent on the far segment at the latest, such as deadline = \"20 ms\"");
                None
            }
            (_, Some(at)) => {
                if let (Some(deadline), Some(validity)) = (deadline, validity)
                    && validity < deadline
                {
                    self.wrong(
                        table.validity.as_ref().unwrap_or(at),
                        "validity",
                        "an event must not expire before its deadline: write a longer one",
                    );
                }
                validity.or(deadline)
            }
        };
        let importance = match &table.importance {
            Some(at) => self.value(
                at,
                "importance",
                |number| Importance::new(u8::try_from(*number).ok()?),
                "write 0 (the most) to 4",
            ),
            None => Some(Importance::LEAST),
        };
        let interval = self.span(Some(&table.interval), "interval");
        let burst = match &table.burst {
            Some(at) => self.value(
                at,
                "burst",
                |number| u8::try_from(*number).ok().filter(|number| *number > 0),
                "write 1 to 255",
            ),
            None => Some(1),
        };
        let (from, to) =
            (self.reach(table.from.as_ref(), "from", class), self.reach(table.to.as_ref(), "to", class));
        let unasked: Vec<_> = table.unasked.iter().filter_map(|at| self.name(at, "unasked")).collect();
        for (at, _) in table.unasked.iter().zip(&unasked).filter(|(_, name)| !to.has(name)) {
            self.wrong(at, "unasked", "the channel may not enter this segment: name it in `to`, too");
        }
        if class == Class::Hard && table.from.is_none() {
            self.wrong(
                &table.class,
                "from",
                "it is missing: name the segments in whose calendars the channel stands",
            );
        }
        Some(ChannelConfig {
            name: table.name.get_ref().clone(),
            subject: subject?,
            class,
            deadline,
            validity,
            importance: importance?,
            rate: EventRate::sporadic(interval?).with_burst(burst?),
            longest_wait,
            from,
            to,
            unasked,
        })
    }

    /// A hard real-time channel leaves and enters only the segments that are named.
    fn reach(&mut self, list: Option<&Vec<Text>>, field: &str, class: Class) -> Reach {
        match list {
            Some(list) => Reach::Only(list.iter().filter_map(|at| self.name(at, field)).collect()),
            None if class == Class::Hard => Reach::NONE,
            None => Reach::All,
        }
    }
}

/// The etags that a plan fixes, of the channels that may cross; those of hard real-time channels stand in the calendar.
fn planned_etags(plan: &SegmentPlan, channels: &[ChannelConfig]) -> Vec<(Subject, Etag)> {
    let etag = |channel: &ChannelConfig| {
        let planned = plan.channel(plan.channel_of_subject(channel.subject)?).etag?;
        (!planned.is_hard() && !planned.is_reserved()).then_some((channel.subject, planned))
    };
    channels.iter().filter_map(etag).collect()
}

/// Why a channel cannot have an etag in a segment: its plan gives it another, or another channel has it.
fn taken(
    etag: Etag,
    subject: Subject,
    etags: &HashMap<Subject, Etag>,
    plan: Option<&SegmentPlan>,
) -> Option<String> {
    let number = etag.get();
    let planned = |plan: &SegmentPlan| plan.channel(plan.channel_of_subject(subject)?).etag;
    if let Some(planned) = plan.and_then(planned).filter(|planned| *planned != etag) {
        return Some(format!(
            "the plan gives this channel {}, not {number}: leave it out here",
            planned.get()
        ));
    }
    let of_plan = |plan: &SegmentPlan| Subject::new(plan.channel(plan.channel_of_etag(etag)?).subject);
    let here = etags.iter().find(|(_, other)| **other == etag).map(|(other, _)| *other);
    let other = here.or(plan.and_then(of_plan)).filter(|other| *other != subject)?;
    Some(format!("{number} is the etag of the subject {other} already: each channel needs one of its own"))
}

fn hexadecimal(text: &str) -> Option<u64> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    digits.bytes().all(|byte| byte.is_ascii_hexdigit()).then(|| u64::from_str_radix(digits, 16).ok())?
}

const DEFAULT_CEILING: Percent = Percent::new(20).unwrap();
