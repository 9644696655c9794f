//! What a cluster file may say.
//!
//! The structures here are the file's tables, field by field; the JSON schema for editors
//! (`schema`) is made from them, so their documentation is the format's documentation. Their
//! fields are optional where a mistake can leave them out; what must be there is marked `required`.

use super::contents::{self, ContentTable};
use super::values::{
    BindingName, ChannelSubject, ClassName, Name, PositiveSpan, Rate, ShortId, Span, Succession, Uid,
    UnplannedName,
};
use crate::document::{At, Log, Node, Place, Source, Table};
#[cfg(feature = "cli")]
use schemars::JsonSchema;

/// A COSMIC segment: its nodes, event channels and foreign frames.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(title = "COSMIC segment", deny_unknown_fields))]
pub struct ClusterFile {
    /// What holds for the whole segment.
    pub segment: SegmentTable,
    /// The faults under which the bounds of soft and non real-time channels hold. Without this table:
    /// no faults. Hard real-time channels have their omission degree instead.
    pub errors: Option<ErrorsTable>,
    /// The nodes.
    pub node: Vec<NodeTable>,
    /// The event channels.
    pub channel: Vec<ChannelTable>,
    /// What stands in the bytes of events.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub content: Vec<ContentTable>,
    /// Frames on the bus that are not COSMIC's.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub foreign: Vec<ForeignTable>,
    /// Groups of hard real-time channels that share one fault budget.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub pool: Vec<PoolTable>,
}

/// What holds for the whole segment.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct SegmentTable {
    /// What the segment is called.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub name: Option<At<Name>>,
    /// The bit rate of the bus.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub bit_rate: Option<At<Rate>>,
    /// ε: how far any node's clock may be from global time.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub clock_accuracy: Option<At<Span>>,
    /// How late a node may act on an instant that has come.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub release_jitter: Option<At<Span>>,
    /// Do nodes believe only what agrees with this file: who is time master, which node has which short id, which
    /// subject which etag, who publishes what? Needs `binding = "static"`. False if not given.
    pub sealed: Option<At<bool>>,
    /// Names of the nodes that may host an event channel broker in a sealed cluster; none if not given.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub brokers: Vec<At<String>>,
    /// How etags of soft and non real-time channels are found; "static" if not given.
    pub binding: Option<At<BindingName>>,
    /// What becomes of a soft real-time channel that a node announces and that is not in this file: "ask" the broker's node,
    /// "refuse" it, send it as "non-real-time", or "allow" it unproven. "ask" if not given and binding is "broker", else
    /// "allow". A node that has no broker to ask refuses. Has no effect in a sealed cluster, which refuses all.
    pub unplanned: Option<At<UnplannedName>>,
    /// How often the clock master sends sync and follow-up; "100 ms" if not given, "0 s" for never.
    pub sync_period: Option<At<Span>>,
    /// How late a node takes the time-stamp of a frame at worst: latency of the interrupt and resolution of the
    /// timer; "10 us" if not given.
    pub stamp_latency: Option<At<Span>>,
    /// May nodes fail to load their next frame within the inter-frame space (3 bit times)? Then a frame of
    /// lower priority can slip in behind each, and bounds are longer. False if not given.
    pub slow_refill: Option<At<bool>>,
    /// Δt_p: the span of deadlines that one priority stands for; the longest frame (160 bit times) if
    /// not given.
    pub priority_step: Option<At<PositiveSpan>>,
}

/// Faults: either `burst` and `interval`, or `count` and `window`.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct ErrorsTable {
    /// So many faults at once, then one every `interval`.
    pub burst: Option<At<u32>>,
    /// The distance of two faults after the burst.
    pub interval: Option<At<PositiveSpan>>,
    /// At most so many faults in any `window`.
    pub count: Option<At<u32>>,
    /// The window that `count` is about.
    pub window: Option<At<PositiveSpan>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
    /// Fields that stand there and are not what they should be.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub malformed: Vec<&'static str>,
}

/// A node.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct NodeTable {
    /// Its name.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub name: Option<At<Name>>,
    /// Its UID, unique in the world.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub uid: Option<At<Uid>>,
    /// Its short id, 0..=126; counted from 1 in the order of the file if not given. "ask": it asks the broker for one.
    pub tx_node: Option<At<ShortId>>,
    /// Its place in the succession of time masters, 0 the first; in the order of the file if not given, the
    /// first sixteen nodes. "never": it does not become master.
    pub rank: Option<At<Succession>>,
    /// Names of the channels that it publishes.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub publishes: Vec<At<String>>,
    /// Names of the channels that it subscribes to.
    #[cfg_attr(feature = "cli", schemars(default))]
    pub subscribes: Vec<At<String>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
}

/// An event channel.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct ChannelTable {
    /// Its name.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub name: Option<At<Name>>,
    /// Its subject, unique in the world.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub subject: Option<At<ChannelSubject>>,
    /// Its class.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub class: Option<At<ClassName>>,
    /// What stands in its events: the name of a `[[content]]`.
    pub content: Option<At<String>>,
    /// Bytes of an event at most: 0..=8; non real-time up to 1024, in fragments. That of the content if not given;
    /// must be given if there is none.
    #[cfg_attr(feature = "cli", schemars(range(min = 0, max = 1024)))]
    pub length: Option<At<u16>>,
    /// One event in every period. Either this or `min_interarrival`.
    pub period: Option<At<PositiveSpan>>,
    /// Events come at least this far apart. Either this or `period`.
    pub min_interarrival: Option<At<PositiveSpan>>,
    /// SRT, NRT with `min_interarrival`: so many events may come at once, and then one every `min_interarrival`;
    /// 1 if not given.
    #[cfg_attr(feature = "cli", schemars(range(min = 1)))]
    pub burst: Option<At<u8>>,
    /// SRT, NRT: how late an event may be published after its nominal instant. HRT: how far the spacing
    /// of slots may deviate from the period if no calendar exists otherwise. Zero if not given; the publisher's
    /// node then lets an event be late by a tenth of its period, 1 ms at most, all the same.
    pub jitter: Option<At<Span>>,
    /// HRT with a period: delivery at the latest, from the start of each period; the end of the period if not given.
    /// HRT with min_interarrival: delivery at the latest, from publication; optional.
    /// SRT: from publication; must be given. NRT: optional.
    pub deadline: Option<At<PositiveSpan>>,
    /// After this span from its publication an event is worthless and is discarded.
    pub validity: Option<At<PositiveSpan>>,
    /// HRT: how many omissions a slot tolerates; 1 if not given.
    pub omission_degree: Option<At<u8>>,
    /// HRT: exactly this ready instant, from the start of each period.
    pub phase: Option<At<Span>>,
    /// HRT: ready not before this instant of each period.
    pub earliest: Option<At<Span>>,
    /// HRT: behind another channel's slot.
    pub after: Option<AfterTable>,
    /// NRT: 0 (most important) to 4 (least, the default).
    #[cfg_attr(feature = "cli", schemars(range(min = 0, max = 4)))]
    pub importance: Option<At<u8>>,
    /// The etag; found by itself if not given. HRT: 100..=1023, else 1024..=16383.
    #[cfg_attr(feature = "cli", schemars(range(min = 100, max = 16383)))]
    pub etag: Option<At<u16>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
    /// Fields that stand there and are not what they should be.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub malformed: Vec<&'static str>,
}

/// "This after that, at most so much later."
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct AfterTable {
    /// The channel that comes first.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub channel: Option<At<String>>,
    /// From its delivery to this channel's ready instant at most.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub within: Option<At<Span>>,
}

/// Foreign frames: one by `id`, `length` and `period`, or all messages of a DBC file.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct ForeignTable {
    /// Its name.
    pub name: Option<At<String>>,
    /// Its identifier.
    pub id: Option<At<u32>>,
    /// Has it an identifier of 29 bits? By the identifier if not given: above 0x7FF it has.
    pub extended: Option<At<bool>>,
    /// Bytes of data.
    #[cfg_attr(feature = "cli", schemars(range(min = 0, max = 8)))]
    pub length: Option<At<u8>>,
    /// Its period or least distance. With `dbc`: of messages without the attribute `GenMsgCycleTime`.
    pub period: Option<At<PositiveSpan>>,
    /// How late it may be queued.
    pub jitter: Option<At<Span>>,
    /// By when it should be sent.
    pub deadline: Option<At<PositiveSpan>>,
    /// A DBC file with the frames, relative to the cluster file.
    pub dbc: Option<At<String>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
    /// Fields that stand there and are not what they should be.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub malformed: Vec<&'static str>,
}

/// Slots that follow each other and share one fault budget.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct PoolTable {
    /// The channels: hard real-time, of one period, of different publishers.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub channels: Vec<At<String>>,
    /// How many faults all their slots together tolerate.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub faults: Option<At<u8>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
}

/// The JSON schema of the file, for editors.
#[cfg(feature = "cli")]
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(ClusterFile).to_value()
}

/// Reads the tables; mismatches are noted in the log.
pub fn read(source: &Source, log: &Log) -> ClusterFile {
    let root = Node::parse(source, log);
    let table = Table::new(&root, "", log);
    let segment = table.node("segment");
    if segment.is_none() {
        table.problem("segment", 0..0, "is missing", "write a table [segment] with name and bit_rate");
    }
    let empty = Node { place: 0..0, kind: crate::document::Kind::Table(Vec::new()) };
    let quiet = Log::default();
    let file = ClusterFile {
        segment: match segment {
            Some(node) => read_segment(&Table::new(node, "segment", log)),
            None => read_segment(&Table::new(&empty, "segment", &quiet)),
        },
        errors: table.entry("errors", read_errors),
        node: table.entries("node", read_node),
        channel: table.entries("channel", read_channel),
        content: table.entries("content", contents::read),
        foreign: table.entries("foreign", read_foreign),
        pool: table.entries("pool", read_pool),
    };
    for (field, count) in [("node", file.node.len()), ("channel", file.channel.len())] {
        if count == 0 && !table.malformed().contains(&field) {
            let help = format!("write at least one [[{field}]]; `cosmic-plan new` shows how");
            table.problem(field, 0..0, "is missing", help);
        }
    }
    table.finish();
    file
}

fn read_segment(table: &Table<'_>) -> SegmentTable {
    let segment = SegmentTable {
        name: table.required("name", "give the segment a name: name = \"vehicle\""),
        bit_rate: table.required("bit_rate", "write bit_rate = \"1 Mbit/s\" or slower"),
        clock_accuracy: table.required("clock_accuracy", "write how far clocks may be off, such as \"5 us\""),
        release_jitter: table.required("release_jitter", "write how late a node may act, such as \"10 us\""),
        sealed: table.optional("sealed"),
        brokers: table.list("brokers"),
        binding: table.optional("binding"),
        unplanned: table.optional("unplanned"),
        sync_period: table.optional("sync_period"),
        stamp_latency: table.optional("stamp_latency"),
        slow_refill: table.optional("slow_refill"),
        priority_step: table.optional("priority_step"),
    };
    table.finish();
    segment
}

fn read_errors(table: &Table<'_>) -> ErrorsTable {
    let errors = ErrorsTable {
        burst: table.optional("burst"),
        interval: table.optional("interval"),
        count: table.optional("count"),
        window: table.optional("window"),
        place: table.place(),
        malformed: table.malformed(),
    };
    table.finish();
    errors
}

fn read_node(table: &Table<'_>) -> NodeTable {
    let help = "leave it out: the program of the node says in its Cargo.toml which board it is for";
    table.refuse("board", "has no effect on the plan", help);
    let node = NodeTable {
        name: table.required("name", "give the node a name: name = \"sensor\""),
        uid: table.required("uid", "give the node a UID: uid = \"0x1122334455667788\""),
        tx_node: table.optional("tx_node"),
        rank: table.optional("rank"),
        publishes: table.list("publishes"),
        subscribes: table.list("subscribes"),
        place: table.place(),
    };
    table.finish();
    node
}

fn read_channel(table: &Table<'_>) -> ChannelTable {
    let channel = ChannelTable {
        name: table.required("name", "give the channel a name: name = \"wheel_speed\""),
        subject: table.required("subject", "give the channel a subject: subject = \"0x1122334455667788\""),
        class: table.required("class", "write class = \"HRT\", \"SRT\" or \"NRT\""),
        content: table.optional("content"),
        length: table.optional("length"),
        period: table.optional("period"),
        min_interarrival: table.optional("min_interarrival"),
        burst: table.optional("burst"),
        jitter: table.optional("jitter"),
        deadline: table.optional("deadline"),
        validity: table.optional("validity"),
        omission_degree: table.optional("omission_degree"),
        phase: table.optional("phase"),
        earliest: table.optional("earliest"),
        after: table.entry("after", read_after),
        importance: table.optional("importance"),
        etag: table.optional("etag"),
        place: table.place(),
        malformed: table.malformed(),
    };
    table.finish();
    channel
}

fn read_after(table: &Table<'_>) -> AfterTable {
    let after = AfterTable {
        channel: table.required("channel", "name the channel that comes first"),
        within: table.required("within", "write how much later at most: within = \"2 ms\""),
    };
    table.finish();
    after
}

fn read_foreign(table: &Table<'_>) -> ForeignTable {
    let foreign = ForeignTable {
        name: table.optional("name"),
        id: table.optional("id"),
        extended: table.optional("extended"),
        length: table.optional("length"),
        period: table.optional("period"),
        jitter: table.optional("jitter"),
        deadline: table.optional("deadline"),
        dbc: table.optional("dbc"),
        place: table.place(),
        malformed: table.malformed(),
    };
    table.finish();
    foreign
}

fn read_pool(table: &Table<'_>) -> PoolTable {
    let pool = PoolTable {
        channels: table.list("channels"),
        faults: table.required("faults", "write how many faults the slots together tolerate: faults = 1"),
        place: table.place(),
    };
    table.finish();
    pool
}
