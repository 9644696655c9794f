//! From text to configuration.
//!
//! The whole text is read, whatever is wrong in it: each field that is missing, unknown or none, and what contradicts
//! what else stands there.

mod channel;
mod ip;
mod segment;
mod values;

use std::collections::HashSet;
use std::hash::Hash;
use std::path::Path;

use cosmic_core::protocol::Class;
use cosmic_linux::link::LinkAddress;
use cosmic_plan::document::{At, Log, Node, Place, Problem, Source, Table, file};

use super::{Config, Ip, PageConfig, Problems, SegmentConfig};
use channel::Read as ChannelRead;
use segment::Read as SegmentRead;
use values::WRITE_NAME;

pub(super) fn read(file: &Path) -> Result<Config, Problems> {
    let name = file.display();
    let text = file::read_text(file).map_err(|error| {
        Problems(format!("{name}: it cannot be read: {error}; give the path of a configuration"))
    })?;
    parse(&Source::new(name.to_string(), text), file.parent().unwrap_or(Path::new(".")))
}

pub(super) fn parse(source: &Source, folder: &Path) -> Result<Config, Problems> {
    let log = Log::default();
    let config = Reader { folder, log: &log }.config(&Node::parse(source, &log));
    match (log.into_problems(source), config) {
        (None, Some(config)) => Ok(config),
        (Some(problems), _) => Err(Problems(problems.to_string().trim_end().to_owned())),
        (None, None) => Err(Problems(format!("{}: it is no configuration", source.name()))),
    }
}

/// What a configuration is read with.
struct Reader<'a> {
    /// Paths are taken from here.
    folder: &'a Path,
    log: &'a Log,
}

impl Reader<'_> {
    fn table<'a>(&'a self, node: &'a Node, path: impl Into<String>) -> Table<'a> {
        Table::new(node, path, self.log)
    }

    fn config(&self, root: &Node) -> Option<Config> {
        let table = self.table(root, "");
        let network = values::required_text(&table, "network", values::name, WRITE_NAME);
        let address = |text: &str| text.parse().ok();
        let metrics =
            values::optional_text(&table, "metrics", address, "write an address, such as \"127.0.0.1:9464\"");
        let ip = table.node("ip").map_or_else(Ip::default, |node| ip::read(self, &self.table(node, "ip")));
        let page = table.node("page").map(|node| read_page(&self.table(node, "page")));
        let channels = table.entries("channel", channel::read);
        let segments = table.entries("segment", |table| segment::read(self, table, &channels));
        table.finish();
        self.check_once(&segments, &channels);
        if page.is_some() {
            segments.iter().for_each(|segment| self.check_watched(segment));
        }
        channels.iter().for_each(|channel| self.check_hard(channel, &segments));
        let segments = segments.into_iter().map(|it| it.segment).collect::<Option<_>>();
        let channels = channels.into_iter().map(|it| it.channel).collect::<Option<_>>();
        let metrics = metrics.map(|at| at.value);
        let page = page.flatten();
        Some(Config { network: network?.value, ip, metrics, page, segments: segments?, channels: channels? })
    }

    fn problem(&self, path: &str, field: &str, place: &Place, what: &str, help: &str) {
        let field = format!("{path}.{field}");
        self.log.add(Problem {
            place: Some(place.clone()),
            field,
            what: what.to_owned(),
            help: help.to_owned(),
        });
    }

    /// The page listens to a segment beside the gateway's node.
    fn check_watched(&self, segment: &SegmentRead) {
        let Some(At { value: LinkAddress::Slcan(_), place }) = &segment.link else { return };
        let what =
            "a serial line serves one program at a time, so the page cannot listen to it beside the gateway";
        let help = "leave out [page], or use a link by socketcand or SocketCAN";
        self.problem(&segment.path, "link", place, what, help);
    }

    /// What is there once only.
    fn check_once(&self, segments: &[SegmentRead], channels: &[ChannelRead]) {
        let (mut names, mut links, mut tables) = (HashSet::new(), HashSet::new(), HashSet::new());
        for it in segments {
            let once = |again: Option<&Place>, field, what| {
                again
                    .into_iter()
                    .for_each(|place| self.problem(&it.path, field, place, what, "each has its own"));
            };
            once(again(&mut names, it.name.as_ref(), Clone::clone), "name", "another segment has this name");
            once(
                again(&mut links, it.link.as_ref(), ToString::to_string),
                "link",
                "another segment has this link",
            );
            let what = "another segment keeps its table in this file";
            once(again(&mut tables, it.broker.as_ref(), Clone::clone), "broker", what);
        }
        let (mut names, mut subjects) = (HashSet::new(), HashSet::new());
        for it in channels {
            if let Some(place) = again(&mut names, it.name.as_ref(), Clone::clone) {
                self.problem(&it.path, "name", place, "another channel has this name", "choose another");
            }
            if let Some(place) = again(&mut subjects, it.subject.as_ref(), |subject| *subject) {
                self.problem(&it.path, "subject", place, "another channel has this subject", "state it once");
            }
        }
    }

    /// Where a hard real-time channel comes from it stands in the calendar; elsewhere it is none.
    fn check_hard(&self, read: &ChannelRead, segments: &[SegmentRead]) {
        let Some(channel) = read.channel.as_ref().filter(|it| it.class == Class::Hard) else { return };
        let is_hard = |segment: &SegmentConfig| {
            let planned = segment
                .plan
                .as_ref()
                .and_then(|plan| plan.declare(plan.channel_of_subject(channel.subject)?));
            planned.is_some_and(|planned| planned.attributes().class() == Class::Hard)
        };
        for at in &read.from {
            let here = segments.iter().filter_map(|it| it.segment.as_ref()).find(|it| it.name == at.value);
            if here.is_some_and(|segment| !is_hard(segment)) {
                let what = "the plan of this segment has no such hard real-time channel";
                let help = "give the segment its `plan`, or take the segment out of this list";
                self.problem(&read.path, "from", &at.place, what, help);
            }
        }
        for at in read.to.iter().filter(|at| channel.from.has(&at.value)) {
            let what = "a hard real-time channel cannot enter a segment that it leaves";
            self.problem(&read.path, "to", &at.place, what, "take it out of one list");
        }
    }
}

/// `[page]`: the live page.
fn read_page(table: &Table<'_>) -> Option<PageConfig> {
    let address = |text: &str| text.parse().ok();
    let listen =
        values::required_text(table, "listen", address, "write an address, such as \"127.0.0.1:8117\"");
    let host = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
    let hosts = values::list(table, "hosts", host, "write a name, such as \"gateway.example\"");
    table.finish();
    Some(PageConfig { listen: listen?.value, hosts: hosts.into_iter().map(|at| at.value).collect() })
}

/// Where something stands that stood before.
fn again<'a, T, K: Hash + Eq>(
    seen: &mut HashSet<K>,
    at: Option<&'a At<T>>,
    key: impl FnOnce(&T) -> K,
) -> Option<&'a Place> {
    let At { value, place } = at?;
    (!seen.insert(key(value))).then_some(place)
}
