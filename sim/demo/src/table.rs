//! The report for people: text of at most [`WIDTH`] columns, tables as wide as the names in them.

use core::fmt::{self, Write as _};

use crate::columns::{Column, Columns, agreeing, counted, numbers, words};
use crate::report::{ChannelReport, ExceptionReport, Report, SubscriberReport};
use crate::span::{Range, Span};

/// No line of text is longer; no table either, with names as in the example.
pub const WIDTH: usize = 100;

/// Whether there are colours.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Style {
    /// Plain text.
    Plain,
    /// With the escape sequences of a terminal.
    Colours,
}

/// A report, ready to be printed.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'r> {
    /// What.
    pub report: &'r Report,
    /// How.
    pub style: Style,
}

impl fmt::Display for Tables<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.channels(f)?;
        self.bus(f)?;
        self.exceptions(f)?;
        self.judgement(f)
    }
}

impl Tables<'_> {
    fn heading(&self, f: &mut fmt::Formatter<'_>, text: &str) -> fmt::Result {
        writeln!(f, "{}", self.paint(Colour::Bold, text))
    }

    fn channels(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head = [
            "channel",
            "class",
            "published",
            "subscriber",
            "delivered",
            "miss/exp",
            "min",
            "mean",
            "max",
            "min",
            "mean",
            "max",
        ];
        let of_channel = |channel| {
            let of_subscriber = move |(at, subscriber)| channel_row(channel, subscriber, at == 0);
            channel.subscribers.iter().enumerate().map(of_subscriber)
        };
        let rows: Vec<_> = self.report.channels.iter().flat_map(of_channel).collect();
        let texts: Vec<_> =
            rows.iter().map(|(_, row)| row.clone()).chain([head.map(str::to_owned)]).collect();
        let columns = Columns::wide_enough(CHANNELS, &texts);
        self.heading(f, &ranges_heading(&columns))?;
        self.heading(f, &columns.line(&head.map(str::to_owned)))?;
        for (class, row) in &rows {
            writeln!(f, "{}", self.paint_class(class, &columns.line(row)))?;
        }
        writeln!(
            f,
            "miss/exp: missed (HRT: not delivered in its slot; SRT: sent after its deadline) or expired (SRT)."
        )?;
        writeln!(
            f,
            "Latency: from publication until the event is visible to the subscriber. Jitter, HRT: distance from"
        )?;
        writeln!(f, "the delivery instant of the calendar; SRT, NRT: difference of two latencies in a row.")?;
        let waiting: Vec<_> = self.report.channels.iter().filter_map(remainder).collect();
        if !waiting.is_empty() {
            wrap(f, &format!("Not delivered, and not lost: {}.", waiting.join("; ")))?;
        }
        writeln!(f)
    }

    fn paint_class(&self, class: &str, line: &str) -> String {
        match class {
            "HRT" => self.paint(Colour::Blue, line),
            "SRT" => self.paint(Colour::Green, line),
            _ => line.to_owned(),
        }
    }

    fn bus(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (bus, settings) = (&self.report.bus, &self.report.settings);
        self.heading(f, "bus")?;
        let mut line = format!("load {:.1}% ({:.1}% asked for):", bus.load_percent, settings.load_percent);
        for class in &bus.classes {
            let frames = counted(class.frames, "frame");
            write!(line, " {} {frames} {:.1}%,", class.class, class.load_percent)?;
        }
        write!(line, " errors {:.2}%.", bus.error_load_percent)?;
        wrap(f, &line)?;
        let line = format!(
            "errors injected: {}; attempts destroyed: {}, {} of them because no node was up to acknowledge; frames \
             by destroyed attempts: {}.",
            bus.injected_errors,
            bus.failed_attempts,
            bus.unacknowledged_attempts,
            degrees(&bus.frames_by_omission_degree)
        );
        wrap(f, &line)?;
        let background = &self.report.background;
        let line = format!(
            "background load: {} of {} sent ({} missed {} deadline, {} expired), {} of {} NRT.",
            background.soft_sent,
            counted(background.soft_published, "SRT event"),
            background.soft_missed,
            if background.soft_missed == 1 { "its" } else { "their" },
            background.soft_expired,
            background.non_real_time_sent,
            background.non_real_time_published
        );
        wrap(f, &line)?;
        writeln!(f)
    }

    fn exceptions(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head =
            ["exceptions at", "as", "of channel", "kind", "count", "while starting up"].map(str::to_owned);
        let row = |it: &ExceptionReport| {
            let (role, channel) = (it.role.unwrap_or("-"), it.channel.unwrap_or("-"));
            let (count, starting) = (it.count.to_string(), it.while_starting.to_string());
            [it.node.to_owned(), role.to_owned(), channel.to_owned(), it.kind.to_owned(), count, starting]
        };
        let mut rows = vec![head];
        rows.extend(self.report.exceptions.iter().map(row));
        let columns = Columns::wide_enough(EXCEPTIONS, &rows);
        for (at, row) in rows.iter().enumerate() {
            let line = columns.line(row);
            if at == 0 { self.heading(f, &line)? } else { writeln!(f, "{line}")? }
        }
        if self.report.exceptions.is_empty() {
            writeln!(f, "none")?;
        }
        writeln!(f)
    }

    fn judgement(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = self.report;
        self.heading(f, "judged by the trace of the bus and the records of the nodes")?;
        self.settling(f)?;
        let slots = &report.slots;
        let line = format!(
            "HRT slots: {} judged, {} delivered to all subscribers, {} unused, {} lost; with destroyed attempts: \
             {}, beyond the fault hypothesis: {}.",
            slots.judged,
            slots.delivered,
            slots.unused,
            slots.lost,
            slots.with_faults,
            slots.beyond_hypothesis
        );
        wrap(f, &line)?;
        if slots.without_time > 0 {
            let count = counted(slots.without_time as u64, "slot");
            wrap(f, &format!("{count} not judged: the time master had changed, or could not be heard."))?;
        }
        let (early, late) = slots.allowed_us;
        if let Some(off) = slots.deviation_us {
            let line = format!(
                "HRT delivery: {} to {} from the delivery instant of the calendar; allowed {} to {}.",
                signed(off.min),
                signed(off.max),
                signed(early),
                signed(late)
            );
            wrap(f, &line)?;
        }
        let order = &report.order;
        let worst = order.worst_us.map_or("-".into(), |worst| worst.max(Span::ZERO).to_string());
        let line = format!(
            "SRT order: {} a frame waited while another won, {} a node chose; a more urgent event waited behind \
             one that was less urgent by {worst} at most; allowed {}.",
            counted(order.contests as u64, "time"),
            counted(order.choices as u64, "time"),
            order.bound_us
        );
        wrap(f, &line)?;
        for violation in report.violations.iter().take(MOST_VIOLATIONS) {
            let mut line = String::new();
            wrap(&mut line, &format!("VIOLATED: {violation}"))?;
            write!(f, "{}", self.paint(Colour::Red, &line))?;
        }
        if let Some(more @ 1..) = report.violations.len().checked_sub(MOST_VIOLATIONS) {
            writeln!(f, "... and {more} more")?;
        }
        if report.passed {
            writeln!(
                f,
                "{}",
                self.paint(Colour::Green, "PASSED: all as promised, and every loss was reported.")
            )
        } else {
            let text = match (report.slots.judged, report.violations.len()) {
                (0, 1) => "FAILED: nothing could be judged.".to_owned(),
                (_, count) => format!("FAILED: {}.", counted(count as u64, "violation")),
            };
            writeln!(f, "{}", self.paint(Colour::Red, &text))
        }
    }

    fn settling(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let settling = &self.report.settling;
        let from = match settling.judged_from_us {
            Some(from) => format!("are judged from {:.3} s on", from.as_micros() / 1e6),
            None => "could not be judged".to_owned(),
        };
        let line = format!(
            "HRT slots {from}, when clocks are synchronised and something is published; before, nodes keep silent \
             (exceptions \"clock out of bound\": {}).",
            settling.exceptions
        );
        wrap(f, &line)
    }

    fn paint(&self, colour: Colour, text: &str) -> String {
        match self.style {
            Style::Plain => text.to_owned(),
            Style::Colours => format!("\x1b[{}m{text}\x1b[0m", colour as u8),
        }
    }
}

/// Codes of SGR.
#[derive(Clone, Copy)]
enum Colour {
    Bold = 1,
    Red = 31,
    Green = 32,
    Blue = 34,
}

/// The row of a subscriber, and the class of its channel, which stands in the first row only.
fn channel_row<'r>(
    channel: &'r ChannelReport,
    subscriber: &SubscriberReport,
    first: bool,
) -> (&'r str, [String; 12]) {
    let of_channel = |text: String| if first { text } else { String::new() };
    let [least, mean, greatest] = range(subscriber.latency_us);
    let [least_jitter, mean_jitter, greatest_jitter] = range(subscriber.jitter_us);
    let row = [
        of_channel(channel.name.to_owned()),
        of_channel(channel.class.to_owned()),
        of_channel(channel.published.to_string()),
        subscriber.node.to_owned(),
        subscriber.delivered.to_string(),
        of_channel(missed(channel)),
        least,
        mean,
        greatest,
        least_jitter,
        mean_jitter,
        greatest_jitter,
    ];
    (channel.class, row)
}

/// What the columns of numbers are about, in their midst.
fn ranges_heading(columns: &Columns<12>) -> String {
    let (latency, jitter) = (columns.span(6, 9), columns.span(9, 12));
    let middle = |text: &str, width: usize| width.saturating_sub(text.chars().count()) / 2;
    let before = columns.span(0, 6) - 1 + middle("latency (µs)", latency);
    let at = columns.span(0, 9) - 1 + middle("jitter (µs)", jitter);
    let line = format!("{:before$}latency (µs)", "");
    let between = at.saturating_sub(line.chars().count());
    format!("{line}{:between$}jitter (µs)", "")
}

fn range(range: Option<Range>) -> [String; 3] {
    match range {
        Some(Range { min, mean, max }) => [min, mean, max].map(number),
        None => ["-", "-", "-"].map(str::to_owned),
    }
}

/// At most five characters below a tenth of a second.
fn number(span: Span) -> String {
    let micros = span.as_micros();
    if micros.abs() < 999.95 { format!("{micros:.1}") } else { format!("{micros:.0}") }
}

fn signed(span: Span) -> String {
    format!("{:+.1} µs", span.as_micros())
}

fn missed(channel: &ChannelReport) -> String {
    match channel.class {
        "HRT" => channel.missed.to_string(),
        "SRT" => format!("{}/{}", channel.missed, channel.expired),
        _ => "-".to_owned(),
    }
}

fn remainder(channel: &ChannelReport) -> Option<String> {
    let mut parts = Vec::new();
    for (count, what) in [
        (channel.lost_while_settling, "before the clocks were synchronised"),
        (channel.under_way, agreeing(channel.under_way, "on its way at the end", "on their way at the end")),
        (channel.refused, "refused, with an exception"),
    ] {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    }
    let late = channel.subscribers.iter().filter(|subscriber| subscriber.before > 0);
    parts.extend(
        late.map(|subscriber| format!("{} before {} subscribed", subscriber.before, subscriber.node)),
    );
    (!parts.is_empty()).then(|| format!("{} {}", channel.name, parts.join(", ")))
}

fn degrees(counts: &[u64]) -> String {
    let counts: Vec<_> = counts.iter().enumerate().map(|(k, count)| format!("{k}: {count}")).collect();
    counts.join(", ")
}

/// Writes a text in lines of at most [`WIDTH`]; all but the first are indented.
pub(crate) fn wrap(f: &mut impl fmt::Write, text: &str) -> fmt::Result {
    let mut column = 0;
    for word in text.split(' ') {
        let len = word.chars().count();
        if column > 0 && column + 1 + len > WIDTH {
            write!(f, "\n  {word}")?;
            column = 2 + len;
        } else {
            let space = if column > 0 { " " } else { "" };
            write!(f, "{space}{word}")?;
            column += space.len() + len;
        }
    }
    writeln!(f)
}

const CHANNELS: [Column; 12] = [
    words(11),
    words(5),
    numbers(9),
    words(11),
    numbers(9),
    numbers(8),
    // Latency, then jitter.
    numbers(6),
    numbers(6),
    numbers(6),
    numbers(5),
    numbers(5),
    numbers(5),
];
const EXCEPTIONS: [Column; 6] = [words(13), words(10), words(11), words(30), numbers(6), numbers(18)];
/// More are in the JSON report.
const MOST_VIOLATIONS: usize = 10;
