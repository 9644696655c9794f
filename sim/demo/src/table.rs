//! The report for people: tables of at most [`WIDTH`] columns.

use core::fmt::{self, Write as _};

use crate::report::{ChannelReport, Report, SubscriberReport};
use crate::span::{Range, Span};

/// No line is longer.
pub const WIDTH: usize = 100;

/// Are there colours?
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
        self.heading(
            f,
            "                                                              latency (µs)        jitter (µs)",
        )?;
        self.heading(
            f,
            &row(
                &["channel", "class", "published", "subscriber", "delivered", "miss/exp"],
                &["min", "mean", "max", "min", "mean", "max"],
            ),
        )?;
        for channel in &self.report.channels {
            for (at, subscriber) in channel.subscribers.iter().enumerate() {
                let line = self.channel_row(channel, subscriber, at == 0);
                writeln!(f, "{line}")?;
            }
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

    fn channel_row(&self, channel: &ChannelReport, subscriber: &SubscriberReport, first: bool) -> String {
        let (published, missed) = (channel.published.to_string(), missed(channel));
        let delivered = subscriber.delivered.to_string();
        let words = if first {
            [channel.name, channel.class, &published, subscriber.node, &delivered, &missed]
        } else {
            ["", "", "", subscriber.node, &delivered, ""]
        };
        let numbers: Vec<_> =
            [subscriber.latency_us, subscriber.jitter_us].into_iter().flat_map(numbers).collect();
        let numbers: Vec<_> = numbers.iter().map(String::as_str).collect();
        let line = row(&words, &numbers);
        match channel.class {
            "HRT" => self.paint(Colour::Blue, &line),
            "SRT" => self.paint(Colour::Green, &line),
            _ => line,
        }
    }

    fn bus(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (bus, settings) = (&self.report.bus, &self.report.settings);
        self.heading(f, "bus")?;
        let mut line = format!("load {:.1}% ({:.1}% asked for):", bus.load_percent, settings.load_percent);
        for class in &bus.classes {
            write!(line, " {} {} frames {:.1}%,", class.class, class.frames, class.load_percent)?;
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
            "background load: {} of {} SRT events sent ({} missed their deadline, {} expired), {} of {} NRT.",
            background.soft_sent,
            background.soft_published,
            background.soft_missed,
            background.soft_expired,
            background.non_real_time_sent,
            background.non_real_time_published
        );
        wrap(f, &line)?;
        writeln!(f)
    }

    fn exceptions(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = |node: &str, role: &str, channel: &str, kind: &str, counts: [&str; 2]| {
            let [count, starting] = counts;
            format!("{node:<13} {role:<10} {channel:<11} {kind:<30} {count:>6} {starting:>18}")
        };
        self.heading(f, &line("exceptions at", "as", "of channel", "kind", ["count", "while starting up"]))?;
        for it in &self.report.exceptions {
            let (role, channel) = (it.role.unwrap_or("-"), it.channel.unwrap_or("-"));
            let counts = [it.count, it.while_starting].map(|count| count.to_string());
            writeln!(f, "{}", line(it.node, role, channel, it.kind, counts.each_ref().map(String::as_str)))?;
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
            "SRT order: {} times a frame waited while another won, {} times a node chose; a more urgent event \
             waited behind one that was less urgent by {worst} at most; allowed {}.",
            order.contests, order.choices, order.bound_us
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
            let text = format!("FAILED: {} violations.", report.violations.len());
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

fn row(words: &[&str; 6], numbers: &[&str]) -> String {
    let [channel, class, published, subscriber, delivered, missed] = words;
    let mut line =
        format!("{channel:<11} {class:<5} {published:>9} {subscriber:<11} {delivered:>9} {missed:>8}");
    for (at, number) in numbers.iter().enumerate() {
        let width = if at < 3 { LATENCY } else { JITTER };
        // Cannot fail: the target is a string.
        let _ = write!(line, " {number:>width$}");
    }
    line
}

fn numbers(range: Option<Range>) -> [String; 3] {
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
        (channel.under_way, "on their way at the end"),
        (channel.refused, "refused, with an exception"),
    ] {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    }
    (!parts.is_empty()).then(|| format!("{} {}", channel.name, parts.join(", ")))
}

fn degrees(counts: &[u64]) -> String {
    let counts: Vec<_> = counts.iter().enumerate().map(|(k, count)| format!("{k}: {count}")).collect();
    counts.join(", ")
}

/// Writes a text in lines of at most [`WIDTH`]; all but the first are indented.
fn wrap(f: &mut impl fmt::Write, text: &str) -> fmt::Result {
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

const LATENCY: usize = 6;
const JITTER: usize = 5;
/// More are in the JSON report.
const MOST_VIOLATIONS: usize = 10;
