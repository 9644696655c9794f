//! Draws a snapshot. What a colour says, a word says too.

use cosmic_monitor::{ChannelView, LoadView, NodeView, Notice, Severity};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Cell, Clear, Paragraph, Row, Sparkline, Table, Wrap};

use super::Shown;
use super::screen::{Pane, Screen};
use crate::output::{short, signed};
use crate::words::{last, role};

pub(crate) fn draw(frame: &mut Frame<'_>, screen: &mut Screen, shown: &Shown<'_>) {
    let area = frame.area();
    let nodes = u16::try_from(shown.snapshot.nodes.len()).unwrap_or(u16::MAX);
    let rows = area.height.saturating_sub(HEAD + 1);
    // No list takes more than it needs, and the channels get what is left.
    let node_rows = nodes.saturating_add(2).min(rows / 3).max(3);
    let [head, node_area, channel_area, notice_area, foot] = Layout::vertical([
        Constraint::Length(HEAD),
        Constraint::Length(node_rows),
        Constraint::Min(4),
        Constraint::Length((rows / 4).max(3)),
        Constraint::Length(1),
    ])
    .areas(area);
    draw_head(frame, head, shown);
    draw_nodes(frame, node_area, screen, shown);
    draw_channels(frame, channel_area, screen, shown);
    draw_notices(frame, notice_area, screen, shown);
    draw_foot(frame, foot, shown);
    if screen.shows_findings {
        draw_findings(frame, area, shown);
    }
    if screen.shows_help {
        draw_over(frame, area, " keys ", KEYS.lines().map(Line::from).collect());
    }
}

fn draw_head(frame: &mut Frame<'_>, area: Rect, shown: &Shown<'_>) {
    let [text, history] = Layout::horizontal([Constraint::Min(40), Constraint::Length(32)]).areas(area);
    let snapshot = shown.snapshot;
    let LoadView { bits_per_second, now, frames_per_second, .. } = &snapshot.load;
    let name = snapshot.segment.as_deref().unwrap_or("segment");
    let title = Line::from(vec![
        Span::styled(format!("cosmic top: {name}"), BOLD),
        Span::raw(format!("  {}  {} kbit/s", shown.link, bits_per_second / 1_000)),
    ]);
    let busy = Line::from(format!(
        "load {:5.1} %  {frames_per_second:5.0} frames/s  {} frames in {}",
        now.total() * 100.0,
        snapshot.link.received,
        short(snapshot.listening_ns)
    ));
    let shares = [("HRT", now.hard), ("SRT", now.soft), ("NRT", now.non_real_time), ("foreign", now.foreign)];
    let bars = shares.iter().map(|(class, share)| format!("{class} {} {:4.1} %", bar(*share), share * 100.0));
    let bars = Line::from(bars.collect::<Vec<_>>().join("  "));
    frame.render_widget(Paragraph::new(vec![title, busy, bars, clock_line(shown), link_line(shown)]), text);
    let totals: Vec<u64> =
        snapshot.load.history.iter().map(|share| (share.total() * 1_000.0) as u64).collect();
    let recent = totals.len().saturating_sub(usize::from(history.width.saturating_sub(2)));
    let block = Block::new().borders(Borders::ALL).title(" load, last minute ");
    frame.render_widget(Sparkline::default().block(block).data(&totals[recent..]).max(1_000), history);
}

/// Eight cells, each an eighth of the bus.
fn bar(share: f64) -> String {
    let full = (share.clamp(0.0, 1.0) * 8.0).round() as usize;
    "█".repeat(full) + &"·".repeat(8 - full)
}

fn clock_line(shown: &Shown<'_>) -> Line<'static> {
    let clock = &shown.snapshot.clock;
    let Some(master) = clock.master else { return Line::from("no time master") };
    let mut text = format!("time of {}", (shown.names)(master));
    if let Some(uncertainty) = clock.uncertainty_ns {
        text += &format!(" within {}", short(uncertainty));
    }
    if let Some(calendar) = &clock.calendar {
        text += &format!("  calendar {calendar}");
    }
    for broker in &shown.snapshot.brokers {
        text += &format!("  broker {}", (shown.names)(*broker));
    }
    Line::from(text)
}

fn link_line(shown: &Shown<'_>) -> Line<'static> {
    let link = &shown.snapshot.link;
    if let Some(trouble) = shown.trouble {
        return Line::from(Span::styled(trouble.to_owned(), BAD));
    }
    let mut text = format!("foreign {}  lost {}", link.foreign, link.lost);
    if let Some((transmit, receive)) = link.transmit_errors.zip(link.receive_errors) {
        text += &format!("  errors {transmit}/{receive}");
    }
    if link.lost > 0 { Line::from(Span::styled(text, WARNING)) } else { Line::from(text) }
}

/// A list with its title; the one with the keys is set off.
fn block(pane: Pane, screen: &Screen, title: &str, first: usize, count: usize) -> Block<'static> {
    let more = if first > 0 { format!(" from {}", first + 1) } else { String::new() };
    let style = if screen.focus == pane { BOLD } else { Style::new() };
    let mark = if screen.focus == pane { "▸" } else { " " };
    Block::new().borders(Borders::TOP).title(Span::styled(format!("{mark}{count} {title}{more} "), style))
}

fn draw_nodes(frame: &mut Frame<'_>, area: Rect, screen: &mut Screen, shown: &Shown<'_>) {
    let nodes = &shown.snapshot.nodes;
    let first = screen.first(Pane::Nodes, nodes.len(), usize::from(area.height.saturating_sub(2)));
    let rows = nodes.iter().skip(first).map(node_row);
    let widths = [
        Constraint::Length(2),
        Constraint::Length(14),
        Constraint::Length(14),
        Constraint::Length(12),
        Constraint::Length(8),
        Constraint::Length(8),
        Constraint::Length(10),
        Constraint::Length(9),
    ];
    let heads =
        Row::new(["ID", "NODE", "STATE", "ROLE", "UP", "TEC/REC", "EXCEPTIONS", "FRAMES/S"]).style(BOLD);
    let block = block(Pane::Nodes, screen, "nodes", first, nodes.len());
    frame.render_widget(Table::new(rows, widths).header(heads).block(block), area);
}

fn node_row(node: &NodeView) -> Row<'static> {
    let (state, style) = match (node.alive, node.state) {
        (false, _) => ("silent", BAD),
        (true, Some("operational")) => ("operational", Style::new()),
        (true, Some(state)) => (state, WARNING),
        (true, None) => ("alive", Style::new()),
    };
    let exceptions = if node.exceptions > 0 { WARNING } else { Style::new() };
    let errors = node.transmit_errors.zip(node.receive_errors);
    Row::new([
        Cell::new(format!("{:02X}", node.tx_node)),
        Cell::new(node.name.clone().unwrap_or_else(|| "-".to_owned())),
        Cell::new(Span::styled(state, style)),
        Cell::new(role(node).unwrap_or("-")),
        Cell::new(node.uptime_s.map_or_else(|| "-".to_owned(), |uptime| format!("{uptime} s"))),
        Cell::new(errors.map_or_else(|| "-".to_owned(), |(tec, rec)| format!("{tec}/{rec}"))),
        Cell::new(Span::styled(node.exceptions.to_string(), exceptions)),
        Cell::new(format!("{:.0}", node.frames_per_second)),
    ])
}

fn draw_channels(frame: &mut Frame<'_>, area: Rect, screen: &mut Screen, shown: &Shown<'_>) {
    let channels = &shown.snapshot.channels;
    let first = screen.first(Pane::Channels, channels.len(), usize::from(area.height.saturating_sub(2)));
    let rows = channels.iter().skip(first).map(|channel| channel_row(channel, shown));
    let widths = [
        Constraint::Length(5),
        Constraint::Length(17),
        Constraint::Length(5),
        Constraint::Length(8),
        Constraint::Length(16),
        Constraint::Length(4),
        Constraint::Length(9),
        Constraint::Min(16),
    ];
    let heads = ["ETAG", "CHANNEL", "CLASS", "EVENTS/S", "PUBLISHERS", "SUBS", "LEFT", "LAST"];
    let block = block(Pane::Channels, screen, "channels", first, channels.len());
    frame.render_widget(Table::new(rows, widths).header(Row::new(heads).style(BOLD)).block(block), area);
}

fn channel_row(channel: &ChannelView, shown: &Shown<'_>) -> Row<'static> {
    let publishers = channel.publishers.iter().map(|publisher| (shown.names)(publisher.tx_node));
    let left = channel.latency.map(|latency| latency.least_left_ns);
    let style = if left.is_some_and(|left| left < 0) { WARNING } else { Style::new() };
    Row::new([
        Cell::new(channel.etag.map_or_else(|| "-".to_owned(), |etag| etag.to_string())),
        Cell::new(channel.label()),
        Cell::new(channel.class.map_or("-", |class| class.abbreviation())),
        Cell::new(format!("{:.1}", channel.rate)),
        Cell::new(publishers.collect::<Vec<_>>().join(",")),
        Cell::new(channel.subscribers.len().to_string()),
        Cell::new(Span::styled(left.map_or_else(|| "-".to_owned(), signed), style)),
        Cell::new(last(channel).unwrap_or_else(|| "-".to_owned())),
    ])
}

fn draw_notices(frame: &mut Frame<'_>, area: Rect, screen: &mut Screen, shown: &Shown<'_>) {
    let fit = usize::from(area.height.saturating_sub(1));
    let first = screen.first(Pane::Notices, shown.notices.len(), fit);
    let lines = shown.notices.iter().rev().skip(first).take(fit).map(|notice| notice_line(notice, shown));
    let block = block(Pane::Notices, screen, "notices, newest first", first, shown.notices.len());
    frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(block), area);
}

fn notice_line(notice: &Notice, shown: &Shown<'_>) -> Line<'static> {
    let node = notice.tx_node.map(|node| format!("{} ", (shown.names)(node))).unwrap_or_default();
    let times = if notice.count > 1 { format!(" ({}×)", notice.count) } else { String::new() };
    let names: Vec<&str> = notice.exceptions.iter().map(|exception| exception.name).collect();
    let names = if names.is_empty() { String::new() } else { format!(" [{}]", names.join(", ")) };
    let since = shown.snapshot.listening_ns;
    let text = format!(
        "{:>9}  {node}{}{times}{names}",
        short(notice.at_ns.min(since.max(notice.at_ns))),
        notice.text
    );
    if notice.exceptions.is_empty() { Line::from(text) } else { Line::from(Span::styled(text, WARNING)) }
}

fn draw_foot(frame: &mut Frame<'_>, area: Rect, shown: &Shown<'_>) {
    let errors = shown.findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    let (text, style) = match (shown.findings.first(), errors) {
        (None, _) => ("nothing is wrong".to_owned(), Style::new()),
        (Some(first), 0) => (format!("{} warnings: {first}", shown.findings.len()), WARNING),
        (Some(first), errors) => (format!("{errors} errors: {first}"), BAD),
    };
    let line = Line::from(vec![
        Span::raw("q quit  Tab list  ↑↓ scroll  d doctor  ? keys  "),
        Span::styled(text, style),
    ]);
    frame.render_widget(Paragraph::new(line), area);
}

fn draw_findings(frame: &mut Frame<'_>, area: Rect, shown: &Shown<'_>) {
    let mut lines = Vec::new();
    for finding in shown.findings {
        let style = if finding.severity == Severity::Error { BAD } else { WARNING };
        lines.push(Line::from(Span::styled(finding.to_string(), style)));
        lines.push(Line::from(format!("  {}", finding.remedy)));
    }
    if lines.is_empty() {
        lines.push(Line::from("nothing is wrong"));
    }
    draw_over(frame, area, " doctor ", lines);
}

fn draw_over(frame: &mut Frame<'_>, area: Rect, title: &'static str, lines: Vec<Line<'static>>) {
    let [_, middle, _] =
        Layout::vertical([Constraint::Percentage(10), Constraint::Min(6), Constraint::Percentage(10)])
            .areas(area);
    let [_, middle, _] =
        Layout::horizontal([Constraint::Percentage(5), Constraint::Min(20), Constraint::Percentage(5)])
            .areas(middle);
    frame.render_widget(Clear, middle);
    let block = Block::new().borders(Borders::ALL).title(title);
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).block(block), middle);
}

const KEYS: &str = "\
q, Esc, Ctrl-C   quit
Tab, Shift-Tab   the next or previous list
↑ ↓ PgUp PgDn    scroll it; Home: to its start
d                what is wrong, and what to do
? or h           these keys

LEFT is the least that was left of a soft deadline, by the priorities on the bus.
A name with nothing behind it is planned, and was not heard.";

const HEAD: u16 = 5;
const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);
const WARNING: Style = Style::new().fg(Color::Yellow);
const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
