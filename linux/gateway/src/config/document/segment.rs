//! `[[segment]]`: a bus, and the gateway's node on it.

use std::collections::HashMap;

use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::{ADDRESSES, LinkAddress};
use cosmic_monitor::SegmentPlan;
use cosmic_plan::document::{At, FromNode as _, Kind, Mismatch, Table};
use cosmic_plan::units;

use super::super::{GATEWAYS, GATEWAYS_NAME, SegmentConfig};
use super::Reader;
use super::channel::Read as ChannelRead;
use super::values::{self, WRITE_NAME};
use crate::keys::Name;
use crate::rules::Percent;

/// A segment as it stands in a configuration.
pub(super) struct Read {
    pub(super) name: Option<At<Name>>,
    pub(super) link: Option<At<LinkAddress>>,
    pub(super) broker: Option<At<String>>,
    /// `None` if anything is wrong with it.
    pub(super) segment: Option<SegmentConfig>,
    pub(super) path: String,
}

pub(super) fn read(reader: &Reader<'_>, table: &Table<'_>, channels: &[ChannelRead]) -> Read {
    let name = values::required_text(table, "name", values::name, WRITE_NAME);
    let is_two_way = |text: &str| text.parse().ok().filter(|link| !matches!(link, LinkAddress::Log(_)));
    let write = format!("write {} (a log cannot be published to)", ADDRESSES.replace(" or log:FILE", ""));
    let link = values::required_text(table, "link", is_two_way, &write);
    let uid = |text: &str| NodeUid::new(values::hexadecimal(text)?);
    let write = "write the 64-bit name of the gateway's node in this segment, up to 16 hexadecimal digits and not zero, \
                 such as uid = \"0x6A7E0001\"";
    let uid = values::required_text(table, "uid", uid, write);
    let tx_node = |number: &u8| TxNode::new(*number).filter(|node| *node != TxNode::BROKER);
    let tx_node = values::optional(table, "tx-node", tx_node, "write a number from 0 to 126");
    let broker = table.optional::<String>("broker");
    if let Some(at) = broker.as_ref().filter(|_| !table.stands("tx-node")) {
        table.problem("broker", at.place.clone(), "who hosts the broker needs a fixed id", "add tx-node");
    }
    let plan = read_plan(reader, table);
    let bit_rate = read_bit_rate(table, plan.as_ref());
    let ceiling = read_ceiling(table, plan.as_ref());
    let etags = read_etags(table, plan.as_ref(), channels);
    check_messages(table, plan.as_ref(), channels);
    table.finish();
    let path = table.path().to_owned();
    let segment = (|| {
        Some(SegmentConfig {
            name: name.as_ref()?.value.clone(),
            link: link.as_ref()?.value.clone(),
            uid: uid?.value,
            tx_node: tx_node.map(|at| at.value),
            bit_rate: bit_rate?,
            plan,
            ceiling: ceiling?,
            broker: broker.as_ref().map(|at| reader.folder.join(&at.value)),
            etags,
        })
    })();
    Read { name, link, broker, segment, path }
}

fn read_plan(reader: &Reader<'_>, table: &Table<'_>) -> Option<SegmentPlan> {
    let at = table.optional::<String>("plan")?;
    let file = reader.folder.join(&at.value);
    let refused = match SegmentPlan::read(&file) {
        Ok(plan) => return Some(plan),
        Err(refused) => refused.to_string(),
    };
    let first = refused.lines().next().unwrap_or_default();
    let help = match refused.lines().count() {
        0 | 1 => "name the description of a cluster".to_owned(),
        all => format!("`cosmic-plan check {}` tells the {} more", file.display(), all - 1),
    };
    table.problem("plan", at.place, first, help);
    None
}

fn read_bit_rate(table: &Table<'_>, plan: Option<&SegmentPlan>) -> Option<BitRate> {
    if let Some(plan) = plan {
        table.refuse("bit-rate", "the plan states it", "leave it out here");
        return Some(plan.bit_rate());
    }
    let read = |text: &str| BitRate::new(units::parse_bits_per_second(text)?);
    let bit_rate = values::optional_text(table, "bit-rate", read, "write a rate from 10 kbit/s to 1 Mbit/s");
    if table.stands("bit-rate") { bit_rate.map(|at| at.value) } else { Some(BitRate::MAX) }
}

/// What all that enters may take of the bus: what is stated; else what the plan leaves free; else a fifth.
fn read_ceiling(table: &Table<'_>, plan: Option<&SegmentPlan>) -> Option<Percent> {
    let read = |share: &u8| Percent::new(*share);
    let stated = values::optional(table, "ceiling", read, "write a share of the bus in percent, 1 to 100");
    let Some(plan) = plan else {
        return if table.stands("ceiling") { stated.map(|at| at.value) } else { Some(DEFAULT_CEILING) };
    };
    // At most a hundred.
    let free = (plan.free_share() * 100.0).clamp(0.0, 100.0) as u8;
    match stated {
        Some(at) if at.value.get() > free => {
            let what = format!("the plan leaves {free} % of the bus free, less than {} %", at.value.get());
            let help = "write less, leave it out, or give the plan less to do";
            table.problem("ceiling", at.place, what, help);
            None
        }
        Some(at) => Some(at.value),
        None if table.stands("ceiling") => None,
        None => {
            let free = Percent::new(free);
            if free.is_none() {
                let what = "it leaves nothing of the bus free for what enters";
                table.problem("plan", table.place(), what, "give it less to do");
            }
            free
        }
    }
}

/// The etags that are fixed: by the plan, and by the table.
fn read_etags(
    table: &Table<'_>,
    plan: Option<&SegmentPlan>,
    channels: &[ChannelRead],
) -> HashMap<Subject, Etag> {
    let mut etags = plan.map(|plan| planned_etags(plan, channels)).unwrap_or_default();
    let Some(node) = table.node("etags") else { return etags };
    let Kind::Table(entries) = &node.kind else {
        let what = format!("{} is no table", node.describe());
        table.problem("etags", node.place.clone(), what, "write etags = { heat = 5000, gateways = 5002 }");
        return etags;
    };
    for (key, node) in entries {
        let named = channels.iter().find(|it| it.name.as_ref().is_some_and(|name| name.value == key.value));
        let subject = match named {
            // Without its subject nothing more can be said of it.
            Some(channel) => channel.subject.as_ref().map(|at| at.value),
            None if key.value == GATEWAYS_NAME => Some(GATEWAYS),
            None => {
                let what = format!("there is no channel {:?}", key.value);
                let help = format!("name one of [[channel]], or \"{GATEWAYS_NAME}\"");
                table.problem("etags", key.place.clone(), what, help);
                None
            }
        };
        let etag = match u16::from_node(node) {
            Ok(number) => {
                let at = At { value: number, place: node.place.clone() };
                let is_free =
                    |number: &u16| Etag::new(*number).filter(|etag| !etag.is_hard() && !etag.is_reserved());
                values::checked(table, "etags", at, is_free, "write an etag from 1024 to 16383")
            }
            Err(Mismatch { what, help }) => {
                table.problem("etags", node.place.clone(), what, help);
                None
            }
        };
        let (Some(subject), Some(etag)) = (subject, etag) else { continue };
        if let Some((what, help)) = taken(etag.value, subject, &etags, plan) {
            table.problem("etags", etag.place, what, help);
        }
        etags.insert(subject, etag.value);
    }
    etags
}

/// The etags that a plan fixes, of the channels that may cross; those of hard real-time channels stand in the calendar.
fn planned_etags(plan: &SegmentPlan, channels: &[ChannelRead]) -> HashMap<Subject, Etag> {
    let etag = |channel: &ChannelRead| {
        let subject = channel.subject.as_ref()?.value;
        let planned = plan.channel(plan.channel_of_subject(subject)?).etag?;
        (!planned.is_hard() && !planned.is_reserved()).then_some((subject, planned))
    };
    channels.iter().filter_map(etag).collect()
}

/// Why a channel cannot have an etag in a segment, and what to do: its plan gives it another, or another channel has it.
fn taken(
    etag: Etag,
    subject: Subject,
    etags: &HashMap<Subject, Etag>,
    plan: Option<&SegmentPlan>,
) -> Option<(String, &'static str)> {
    let number = etag.get();
    let planned = |plan: &SegmentPlan| plan.channel(plan.channel_of_subject(subject)?).etag;
    if let Some(planned) = plan.and_then(planned).filter(|planned| *planned != etag) {
        let what = format!("the plan gives this channel {}, not {number}", planned.get());
        return Some((what, "leave it out here"));
    }
    let of_plan = |plan: &SegmentPlan| Subject::new(plan.channel(plan.channel_of_etag(etag)?).subject);
    let here = etags.iter().find(|(_, other)| **other == etag).map(|(other, _)| *other);
    let other = here.or(plan.and_then(of_plan)).filter(|other| *other != subject)?;
    Some((
        format!("{number} is the etag of the subject {other} already"),
        "each channel needs one of its own",
    ))
}

/// A channel carries messages of several frames on all segments, or on none.
fn check_messages(table: &Table<'_>, plan: Option<&SegmentPlan>, channels: &[ChannelRead]) {
    let Some(plan) = plan else { return };
    for channel in channels.iter().filter_map(|it| it.channel.as_ref()) {
        let Some(at) = plan.channel_of_subject(channel.subject) else { continue };
        let planned = plan.carries_messages(at).then(|| usize::from(plan.channel(at).length));
        let (what, help) = match (planned, channel.longest_message) {
            (Some(len), None) => (
                format!("it says that {:?} carries messages of up to {len} bytes", channel.name),
                format!("add longest-message = {len} to the channel"),
            ),
            (Some(len), Some(most)) if most < len => (
                format!("it says that {:?} carries messages of up to {len} bytes, not {most}", channel.name),
                format!("write longest-message = {len} in the channel"),
            ),
            (None, Some(_)) => (
                format!("it says that {:?} carries events of one frame", channel.name),
                "take longest-message out of the channel".to_owned(),
            ),
            _ => continue,
        };
        table.problem("plan", table.place(), what, help);
    }
}

const DEFAULT_CEILING: Percent = Percent::new(20).unwrap();
