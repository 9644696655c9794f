//! The cluster as one page of HTML: nodes, channels with what is proven of them, the calendar as a picture, and the
//! bits of every content. It needs no other file and loads nothing.

use super::svg;
use crate::analysis::segment::Assessment;
use crate::cluster::{Channel, Cluster, PlannedClass, Recurrence};
use crate::contents::{ByteOrder, FieldLayout, Layout};
use crate::plan::Plan;
use crate::units::{show, show_rate};
use cosmic_core::time::Duration;
use std::fmt::Write as _;

/// The text of the page.
pub fn render(cluster: &Cluster, plan: &Plan, assessment: &Assessment, source_name: &str) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_page(&mut out, cluster, plan, assessment, source_name);
    out
}

fn write_page(
    out: &mut String,
    cluster: &Cluster,
    plan: &Plan,
    assessment: &Assessment,
    source_name: &str,
) -> std::fmt::Result {
    let name = escaped(&cluster.name);
    writeln!(out, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">")?;
    writeln!(out, "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">")?;
    writeln!(out, "<title>Segment {name}</title>\n<style>{STYLE}</style>\n</head>\n<body>")?;
    writeln!(out, "<h1>Segment {name}</h1>")?;
    let summary = super::text::summary(cluster, plan, assessment);
    let class = if assessment.holds() { "holds" } else { "fails" };
    writeln!(out, "<p class=\"{class}\">{}</p>", escaped(&summary))?;
    let segment = &cluster.segment;
    writeln!(
        out,
        "<p>{}, clock accuracy {}, release jitter {}. Made by cosmic-plan of {}.</p>",
        show_rate(segment.bit_rate),
        show(segment.accuracy),
        show(segment.release_jitter),
        escaped(source_name)
    )?;
    writeln!(out, "<h2>Calendar</h2>\n<div class=\"picture\">")?;
    let picture = svg::render(cluster, plan, assessment);
    writeln!(out, "{}</div>", picture.split_once("?>").map_or(&*picture, |(_, picture)| picture))?;
    write_nodes(out, cluster)?;
    write_channels(out, cluster, assessment)?;
    if !cluster.contents.is_empty() {
        writeln!(out, "<h2>Contents</h2>")?;
        cluster.contents.iter().try_for_each(|layout| write_content(out, layout))?;
    }
    if !cluster.foreign.is_empty() {
        write_foreign(out, cluster, assessment)?;
    }
    writeln!(out, "</body>\n</html>")
}

fn write_nodes(out: &mut String, cluster: &Cluster) -> std::fmt::Result {
    writeln!(out, "<h2>Nodes</h2>\n<table>")?;
    head(out, &["node", "TxNode", "UID", "master", "publishes", "subscribes to"])?;
    let links = |channels: &[usize]| {
        let link = |at: &usize| {
            let name = &cluster.channels[*at].name;
            format!("<a href=\"#channel-{name}\">{name}</a>")
        };
        channels.iter().map(link).collect::<Vec<_>>().join(", ")
    };
    for node in &cluster.nodes {
        let rank = node.rank.filter(|_| cluster.sync_period.is_some());
        let rank = rank.map_or("never".to_owned(), |rank| format!("rank {}", rank.get()));
        row(
            out,
            &format!("node-{}", node.name),
            &[
                node.name.clone(),
                if node.asks { "asks".to_owned() } else { format!("{:#04x}", node.tx_node.get()) },
                format!("<code>{:#018x}</code>", node.uid),
                rank,
                links(&node.publishes),
                links(&node.subscribes),
            ],
        )?;
    }
    writeln!(out, "</table>")
}

fn write_channels(out: &mut String, cluster: &Cluster, assessment: &Assessment) -> std::fmt::Result {
    writeln!(out, "<h2>Channels</h2>\n<table>")?;
    let columns = [
        "channel",
        "class",
        "subject",
        "etag",
        "events",
        "bytes",
        "content",
        "publisher",
        "bound",
        "deadline",
        "proof",
    ];
    head(out, &columns)?;
    for proven in &assessment.channels {
        let channel = &cluster.channels[proven.channel];
        let content = cluster
            .layout_of(channel)
            .map_or(String::new(), |layout| format!("<a href=\"#content-{0}\">{0}</a>", layout.name));
        let dash = |span: Option<Duration>| span.map_or("–".to_owned(), show);
        row(
            out,
            &format!("channel-{}", channel.name),
            &[
                channel.name.clone(),
                class_of(channel),
                format!("<code>{:#018x}</code>", channel.subject),
                channel.etag.map_or("by the broker".to_owned(), |etag| etag.get().to_string()),
                events(channel),
                channel.length.to_string(),
                content,
                cluster.nodes[proven.node].name.clone(),
                dash(proven.proof.bound),
                dash(proven.proof.deadline),
                escaped(proven.proof.verdict.word()),
            ],
        )?;
    }
    writeln!(out, "</table>")
}

fn class_of(channel: &Channel) -> String {
    match &channel.class {
        PlannedClass::Hard { omission_degree, .. } => format!("HRT, k = {omission_degree}"),
        PlannedClass::Soft => "SRT".to_owned(),
        PlannedClass::NonRealTime { importance } => format!("NRT, importance {importance}"),
    }
}

fn events(channel: &Channel) -> String {
    match channel.recurrence {
        Recurrence::Periodic(span) => format!("every {}", show(span)),
        Recurrence::Sporadic(span) => format!("at least {} apart", show(span)),
    }
}

fn write_content(out: &mut String, layout: &Layout) -> std::fmt::Result {
    writeln!(out, "<h3 id=\"content-{0}\">{0}</h3>", layout.name)?;
    let doc = layout.doc.as_ref().map_or(String::new(), |doc| escaped(doc) + " ");
    let order = match layout.order {
        ByteOrder::Big => "the most significant bit first",
        ByteOrder::Little => "the least significant bit first",
    };
    let bytes = if layout.len == 1 { "byte" } else { "bytes" };
    writeln!(
        out,
        "<p>{doc}{} {bytes}, {order}, version {}, layout <code>{:08x}</code>.</p>",
        layout.len,
        layout.version,
        layout.layout_hash().get()
    )?;
    if layout.len <= SHOWN_BYTES {
        write_bits(out, layout)?;
    }
    writeln!(out, "<table>")?;
    head(out, &["field", "type", "first bit", "value", "unit", "range", "is"])?;
    for field in &layout.fields {
        let count = field.count.map_or(String::new(), |count| format!(" × {count}"));
        row(
            out,
            &format!("field-{}-{}", layout.name, field.name),
            &[
                field.name.clone(),
                field.kind.name() + &count,
                format!("{} (byte {}, bit {})", field.at, field.at / 8, bit_in_byte(layout, field.at)),
                meaning(field),
                escaped(field.unit.as_deref().unwrap_or("")),
                range(field),
                escaped(field.doc.as_deref().unwrap_or("")),
            ],
        )?;
    }
    writeln!(out, "</table>")
}

/// The number of a bit within its byte, 7 the highest.
fn bit_in_byte(layout: &Layout, at: usize) -> usize {
    match layout.order {
        ByteOrder::Big => 7 - at % 8,
        ByteOrder::Little => at % 8,
    }
}

fn meaning(field: &FieldLayout) -> String {
    if !field.labels.is_empty() {
        let labels = field.labels.iter().map(|label| format!("{} = {}", label.raw, label.name));
        return labels.collect::<Vec<_>>().join(", ");
    }
    match field.scaling {
        None => String::new(),
        Some(scaling) if scaling.offset == 0 => format!("number × {}", scaling.scale()),
        Some(scaling) => format!("number × {} + {}", scaling.scale(), scaling.offset()).replace("+ -", "− "),
    }
}

fn range(field: &FieldLayout) -> String {
    field.range.map_or(String::new(), |(least, greatest)| format!("{least} to {greatest}"))
}

/// A row for each byte, a column for each bit, the highest on the left.
fn write_bits(out: &mut String, layout: &Layout) -> std::fmt::Result {
    writeln!(out, "<table class=\"bits\">")?;
    let bits: Vec<String> = (0..8).rev().map(|bit| bit.to_string()).collect();
    let mut columns = vec!["byte"];
    columns.extend(bits.iter().map(String::as_str));
    head(out, &columns)?;
    for byte in 0..layout.len {
        write!(out, "<tr><th>{byte}</th>")?;
        let mut bit = 8;
        while bit > 0 {
            let owner = owner(layout, byte, bit - 1);
            let mut width = 1;
            while width < bit && self::owner(layout, byte, bit - 1 - width) == owner {
                width += 1;
            }
            let (class, name) = match owner {
                Some((at, _)) => (format!("f{}", at % SHADES), layout.fields[at].name.as_str()),
                None => ("unused".to_owned(), ""),
            };
            write!(out, "<td colspan=\"{width}\" class=\"{class}\">{name}</td>")?;
            bit -= width;
        }
        writeln!(out, "</tr>")?;
    }
    writeln!(out, "</table>")
}

/// The field that a bit of a byte belongs to, and which of its values.
fn owner(layout: &Layout, byte: usize, bit: usize) -> Option<(usize, usize)> {
    let at = 8 * byte
        + match layout.order {
            ByteOrder::Big => 7 - bit,
            ByteOrder::Little => bit,
        };
    let field = layout.fields.iter().position(|field| field.span().contains(&at))?;
    Some((field, (at - layout.fields[field].at) / layout.fields[field].kind.bits()))
}

fn write_foreign(out: &mut String, cluster: &Cluster, assessment: &Assessment) -> std::fmt::Result {
    writeln!(out, "<h2>Foreign frames</h2>\n<table>")?;
    head(out, &["frame", "identifier", "bytes", "period", "bound", "deadline", "proof"])?;
    for (frame, proof) in cluster.foreign.iter().zip(&assessment.foreign) {
        let dash = |span: Option<Duration>| span.map_or("–".to_owned(), show);
        row(
            out,
            "",
            &[
                escaped(&frame.name),
                format!("<code>{:#x}</code>", frame.id),
                frame.length.to_string(),
                show(frame.period),
                dash(proof.bound),
                dash(proof.deadline),
                escaped(proof.verdict.word()),
            ],
        )?;
    }
    writeln!(out, "</table>")
}

fn head(out: &mut String, columns: &[&str]) -> std::fmt::Result {
    let cells: String = columns.iter().map(|column| format!("<th>{column}</th>")).collect();
    writeln!(out, "<tr>{cells}</tr>")
}

/// The cells are HTML already.
fn row(out: &mut String, id: &str, cells: &[String]) -> std::fmt::Result {
    let id = if id.is_empty() { String::new() } else { format!(" id=\"{id}\"") };
    let cells: String = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
    writeln!(out, "<tr{id}>{cells}</tr>")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Contents up to so many bytes are drawn bit by bit.
const SHOWN_BYTES: usize = 64;
/// So many colours tell neighbours apart.
const SHADES: usize = 6;

const STYLE: &str = "
body { font-family: 'DejaVu Sans', Verdana, sans-serif; font-size: 14px; margin: 2em auto; max-width: 1400px; padding: 0 1em }
h2 { margin-top: 2em } table { border-collapse: collapse; margin: 0.5em 0 }
th, td { border: 1px solid #ccc; padding: 0.25em 0.6em; text-align: left; vertical-align: top }
th { background: #f2f2f2 } code { font-size: 13px } .picture { overflow-x: auto } .picture svg { width: 100%; min-width: 900px }
.holds { background: #d9efd5; padding: 0.5em 1em } .fails { background: #f6d5d5; padding: 0.5em 1em }
.bits td { min-width: 2.2em; text-align: center } .unused { background: #eee }
.f0 { background: #bcd2ee } .f1 { background: #f3e2b3 } .f2 { background: #cfe8cf } .f3 { background: #e6cfe8 }
.f4 { background: #f5cdb8 } .f5 { background: #c9e6ea }
";
