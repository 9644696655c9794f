//! From the tables of a file to a cluster that can only be valid.

mod asking;
mod channel;
mod foreign;
mod recurrence;
mod sealing;
mod segment;

use super::contents::Contents;
use super::format::{self, ChannelTable, ClusterFile, NodeTable};
use super::values::BindingName;
use super::{Binding, Channel, Cluster, Node, PlannedClass, Pool, Wishes};
use crate::analysis::errors::ErrorModel;
use crate::document::{At, Log, Place, Problem, Problems, Source, nearest};
use crate::units::show;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::network::fragments::MAX_MESSAGE_LEN;
use cosmic_core::protocol::Rank;
use cosmic_core::time::Duration;
use std::collections::HashMap;
use std::path::Path;

const ZERO: Duration = Duration::from_ticks(0);

pub(super) fn read(source: &Source) -> Result<Cluster, Problems> {
    let log = Log::default();
    let file = format::read(source, &log);
    let checker = Checker { log: &log };
    let cluster = checker.cluster(&file, Path::new(source.name()).parent().unwrap_or(Path::new("")));
    match log.into_problems(source) {
        Some(problems) => Err(problems),
        None => Ok(cluster),
    }
}

struct Checker<'a> {
    log: &'a Log,
}

/// Names that others refer to.
struct Names<'a> {
    list: Vec<&'a str>,
    positions: HashMap<&'a str, usize>,
}

impl<'a> Names<'a> {
    fn of(names: impl Iterator<Item = &'a str>) -> Self {
        let list: Vec<&str> = names.collect();
        let mut positions = HashMap::new();
        for (at, name) in list.iter().enumerate() {
            positions.entry(*name).or_insert(at);
        }
        Self { list, positions }
    }

    fn position(&self, name: &str) -> Option<usize> {
        self.positions.get(name).copied()
    }
}

impl Checker<'_> {
    fn problem(&self, place: &Place, field: String, what: impl Into<String>, help: impl Into<String>) {
        self.log.add(Problem { place: Some(place.clone()), field, what: what.into(), help: help.into() });
    }

    /// Where something is wrong already, defaults stand in; the cluster is then not used.
    fn cluster(&self, file: &ClusterFile, folder: &Path) -> Cluster {
        let (segment, priority_step) = self.segment(&file.segment);
        let names = Names::of(file.channel.iter().map(|c| name_of(&c.name)));
        let contents = Contents { log: self.log }.layouts(&file.content);
        self.unique("content", file.content.iter().map(|c| (&c.name, &c.place)), |at| at.value.0.clone());
        let mut channels: Vec<Channel> =
            file.channel.iter().map(|c| self.channel(c, &names, &contents)).collect();
        let binding = match file.segment.binding.as_ref().map(|at| at.value) {
            Some(BindingName::Broker) => Binding::Broker,
            _ => Binding::Static,
        };
        self.etags(&file.channel, &mut channels, binding);
        let nodes = self.nodes(&file.node, &names);
        let sync_period =
            file.segment.sync_period.as_ref().map_or(Duration::from_millis(100), |at| at.value.0);
        self.unique("channel", file.channel.iter().map(|c| (&c.name, &c.place)), |at| at.value.0.clone());
        let subjects = file.channel.iter().map(|c| (&c.subject, &c.place));
        self.unique("channel", subjects, |at| format!("subject {:#018x}", at.value.0));
        let cluster = Cluster {
            name: name_of(&file.segment.name).to_owned(),
            segment,
            sealed: self.sealing(&file.segment, &file.node),
            binding,
            unplanned: self.unplanned(&file.segment, binding),
            priority_step,
            slow_refill: file.segment.slow_refill.as_ref().is_some_and(|at| at.value),
            sync_period: Some(sync_period).filter(|span| !span.is_zero()),
            stamp_latency: file
                .segment
                .stamp_latency
                .as_ref()
                .map_or(segment::USUAL_STAMP_LATENCY, |at| at.value.0),
            errors: file.errors.as_ref().map_or(ErrorModel::None, |errors| self.errors(errors)),
            nodes,
            channels,
            contents,
            foreign: file.foreign.iter().flat_map(|f| self.foreign(f, folder)).collect(),
            pools: Vec::new(),
            files: file
                .foreign
                .iter()
                .filter_map(|f| f.dbc.as_ref())
                .map(|at| folder.join(&at.value))
                .collect(),
        };
        self.clock(&file.segment, &cluster);
        self.use_of_channels(file, &cluster);
        self.reserved_subjects(&file.channel);
        self.asking(&file.node, &cluster);
        self.hyperperiod(file, &cluster);
        let pools = file.pool.iter().map(|pool| self.pool(pool, &cluster)).collect();
        Cluster { pools, ..cluster }
    }

    fn resolve(&self, at: &At<String>, names: &Names<'_>, field: String, kind: &str) -> Option<usize> {
        let found = names.position(&at.value);
        if found.is_none() {
            // Comparing with all names costs time, which a file full of mistakes has not.
            let few = self.log.len() < MOST_COMPARED;
            let help = match few.then(|| nearest(&at.value, names.list.iter().copied())).flatten() {
                Some(name) => format!("did you mean `{name}`?"),
                None => format!("write a [[{kind}]] with name = {:?}", at.value),
            };
            self.problem(&at.place, field, format!("there is no {kind} {:?}", at.value), help);
        }
        found
    }

    fn nodes(&self, tables: &[NodeTable], names: &Names<'_>) -> Vec<Node> {
        let given: Vec<u8> = tables.iter().filter_map(|t| t.tx_node.as_ref()?.value.0).collect();
        let mut free = (1..=TxNode::MAX.get()).filter(|id| !given.contains(id));
        let taken: Vec<Rank> = tables.iter().filter_map(|t| t.rank.as_ref()?.value.0).collect();
        let mut ranks = (0..=Rank::LAST.get()).filter_map(Rank::new).filter(|rank| !taken.contains(rank));
        let has_one = |t: &&NodeTable| t.rank.as_ref().is_none_or(|at| at.value.0.is_some());
        self.unique("node", tables.iter().filter(has_one).map(|t| (&t.rank, &t.place)), |at| {
            format!("rank {}", at.value.0.map_or(0, Rank::get))
        });
        self.unique("node", tables.iter().map(|t| (&t.name, &t.place)), |at| at.value.0.clone());
        self.unique("node", tables.iter().map(|t| (&t.uid, &t.place)), |at| {
            format!("uid {:#018x}", at.value.0)
        });
        let has_id = |t: &&NodeTable| t.tx_node.as_ref().is_none_or(|at| at.value.0.is_some());
        self.unique("node", tables.iter().filter(has_id).map(|t| (&t.tx_node, &t.place)), |at| {
            format!("tx_node {}", at.value.0.unwrap_or_default())
        });
        tables.iter().map(|table| self.node(table, names, &mut free, &mut ranks)).collect()
    }

    fn node(
        &self,
        table: &NodeTable,
        names: &Names<'_>,
        free: &mut dyn Iterator<Item = u8>,
        ranks: &mut dyn Iterator<Item = Rank>,
    ) -> Node {
        let name = name_of(&table.name);
        let given = table.tx_node.as_ref().and_then(|at| at.value.0);
        let tx_node = given.or_else(|| free.next()).and_then(TxNode::new).filter(|id| *id <= TxNode::MAX);
        if tx_node.is_none() {
            let place = table.tx_node.as_ref().map_or(start_of(&table.place), |at| at.place.clone());
            let help = "write a number from 0 to 126 that no other node has";
            self.problem(&place, format!("node.{name}.tx_node"), "there is no such short id", help);
        }
        let resolve = |list: &[At<String>], field: &str| {
            let path = format!("node.{name}.{field}");
            list.iter().filter_map(|at| self.resolve(at, names, path.clone(), "channel")).collect()
        };
        Node {
            name: name.to_owned(),
            uid: table.uid.as_ref().map_or(1, |at| at.value.0),
            tx_node: tx_node.unwrap_or(TxNode::MIN),
            asks: table.tx_node.as_ref().is_some_and(|at| at.value.0.is_none()),
            rank: table.rank.as_ref().map_or_else(|| ranks.next(), |at| at.value.0),
            publishes: resolve(&table.publishes, "publishes"),
            subscribes: resolve(&table.subscribes, "subscribes"),
        }
    }

    fn unique<'t, T: 't>(
        &self,
        kind: &str,
        items: impl Iterator<Item = (&'t Option<At<T>>, &'t Place)>,
        key: impl Fn(&At<T>) -> String,
    ) {
        let mut seen = HashMap::new();
        for (item, _) in items {
            let Some(at) = item else { continue };
            let key = key(at);
            if seen.insert(key.clone(), ()).is_some() {
                let help = format!("every {kind} needs its own");
                self.problem(&at.place, kind.to_owned(), format!("{key} stands here a second time"), help);
            }
        }
    }

    /// Etags that the file gives, then the free ones in the order of the file.
    fn etags(&self, tables: &[ChannelTable], channels: &mut [Channel], binding: Binding) {
        let given: Vec<u16> = tables.iter().filter_map(|t| t.etag.as_ref()).map(|at| at.value).collect();
        self.unique("channel", tables.iter().map(|t| (&t.etag, &t.place)), |at| format!("etag {}", at.value));
        let mut hard = (Etag::HARD_FIRST.get()..=Etag::HARD_LAST.get()).filter(|e| !given.contains(e));
        let mut bound =
            (Etag::BOUND_FIRST.get()..=Etag::BOUND_LAST.get()).rev().filter(|e| !given.contains(e));
        for (table, channel) in tables.iter().zip(channels) {
            let is_hard = matches!(channel.class, PlannedClass::Hard { .. });
            channel.etag = match &table.etag {
                Some(at) => {
                    Etag::new(at.value).filter(|etag| !etag.is_reserved() && etag.is_hard() == is_hard)
                }
                None if is_hard => hard.next().and_then(Etag::new),
                None if binding == Binding::Static => bound.next().and_then(Etag::new),
                None => continue,
            };
            if channel.etag.is_none() {
                let (what, place) = match &table.etag {
                    Some(at) => (format!("{} is not an etag of this class", at.value), at.place.clone()),
                    None => ("there is no etag left".to_owned(), start_of(&table.place)),
                };
                let help = "hard real-time channels have 100..=1023, the others 1024..=16383";
                self.problem(&place, format!("channel.{}.etag", channel.name), what, help);
            }
        }
    }

    /// Every channel must have a publisher; a hard real-time channel is of no use otherwise, and the
    /// analysis of the others would be of nothing.
    fn use_of_channels(&self, file: &ClusterFile, cluster: &Cluster) {
        for (at, (channel, table)) in cluster.channels.iter().zip(&file.channel).enumerate() {
            if table.name.is_some() && cluster.publishers(at).next().is_none() {
                let help = format!("write {:?} into the `publishes` of a node", channel.name);
                let place = table.name.as_ref().map_or(0..0, |at| at.place.clone());
                self.problem(&place, format!("channel.{}", channel.name), "no node publishes it", help);
            }
            let PlannedClass::Hard { wishes: Wishes { after: Some(after), .. }, .. } = &channel.class else {
                continue;
            };
            let Some(first) = cluster.channels.get(after.channel) else { continue };
            let place =
                table.after.as_ref().and_then(|a| a.channel.as_ref()).map_or(0..0, |at| at.place.clone());
            let field = format!("channel.{}.after.channel", channel.name);
            if !matches!(first.class, PlannedClass::Hard { .. }) {
                let what = format!("{} has no slot", first.name);
                self.problem(&place, field, what, "name a hard real-time channel");
                continue;
            }
            let (a, b) = (first.recurrence.span().as_ticks(), channel.recurrence.span().as_ticks());
            if a % b != 0 && b % a != 0 {
                let what = format!(
                    "neither of the two periods divides the other ({} and {})",
                    show(first.recurrence.span()),
                    show(channel.recurrence.span())
                );
                self.problem(&place, field, what, "make one period a multiple of the other");
            }
        }
    }

    fn hyperperiod(&self, file: &ClusterFile, cluster: &Cluster) {
        let mut cycle: u64 = 1;
        for (channel, table) in cluster.channels.iter().zip(&file.channel) {
            if !matches!(channel.class, PlannedClass::Hard { .. })
                || channel.recurrence.span() == UNKNOWN_PERIOD
            {
                continue;
            }
            let period = channel.recurrence.span().as_ticks();
            let longest = Calendar::LONGEST_CYCLE.as_ticks();
            match (period / gcd(cycle, period)).checked_mul(cycle).filter(|cycle| *cycle <= longest) {
                Some(longer) => cycle = longer,
                None => {
                    let place = table.period.as_ref().or(table.min_interarrival.as_ref());
                    let what = "with this period the calendar repeats only after more than an hour";
                    let help = "choose periods with a common multiple under an hour, such as 5, 10, 20 ms";
                    let place = place.map_or(start_of(&table.place), |at| at.place.clone());
                    self.problem(&place, format!("channel.{}.period", channel.name), what, help);
                }
            }
        }
    }

    fn pool(&self, table: &format::PoolTable, cluster: &Cluster) -> Pool {
        let names = Names::of(cluster.channels.iter().map(|c| c.name.as_str()));
        let mut pool = Pool { channels: Vec::new(), faults: table.faults.as_ref().map_or(1, |at| at.value) };
        for at in &table.channels {
            let Some(channel) = self.resolve(at, &names, "pool.channels".to_owned(), "channel") else {
                continue;
            };
            let wrong = match &cluster.channels[channel].class {
                PlannedClass::Hard { .. } if pool.channels.contains(&channel) => Some("stands there twice"),
                PlannedClass::Hard { .. } => None,
                _ => Some("is not hard real-time"),
            };
            if let Some(what) = wrong {
                let help = "list different hard real-time channels";
                self.problem(&at.place, "pool.channels".to_owned(), format!("{} {what}", at.value), help);
            }
            pool.channels.push(channel);
        }
        let place = table.channels.first().map_or(start_of(&table.place), |at| at.place.clone());
        if let Some((what, help)) = unfit(&pool, cluster) {
            self.problem(&place, "pool.channels".to_owned(), what, help);
        }
        pool
    }
}

/// Why these channels cannot share one fault budget.
fn unfit(pool: &Pool, cluster: &Cluster) -> Option<(&'static str, &'static str)> {
    let Some(first) = pool.channels.first() else { return Some(("is empty", "list at least two channels")) };
    let period = cluster.channels[*first].recurrence.span();
    if pool.channels.iter().any(|c| cluster.channels[*c].recurrence.span() != period) {
        return Some(("the periods differ", "pool channels of one period"));
    }
    let mut publishers = Vec::new();
    for node in pool.channels.iter().flat_map(|c| cluster.publishers(*c)) {
        // A node has one mailbox for hard real-time; its second frame would not be waiting on the bus.
        if publishers.contains(&node.uid) {
            return Some(("two slots have the same publisher", "pool channels of different nodes"));
        }
        publishers.push(node.uid);
    }
    None
}

fn name_of(name: &Option<At<super::values::Name>>) -> &str {
    name.as_ref().map_or("", |at| &at.value.0)
}

fn start_of(place: &Place) -> Place {
    place.start..place.start
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// With so many problems names are no longer compared for the one that may be meant.
const MOST_COMPARED: usize = 100;

/// Stands in for a period that is not known. Longer than any, so that nothing in the channel is too long for it.
const UNKNOWN_PERIOD: Duration = crate::units::LONGEST_SPAN;

/// Bytes of the longest fragmented event.
pub(super) const LONGEST_EVENT: u16 = MAX_MESSAGE_LEN as u16;
