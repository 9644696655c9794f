//! Events that cross, in words and for machines.

use cosmic_core::Subject;
use cosmic_core::time::Instant;
use cosmic_gateway::ip::Heard;
use cosmic_monitor::{DecodedField, SegmentPlan, class_name, hex_text};
use serde::Serialize;

use crate::context::Context;
use crate::failure::Failure;
use crate::output::{Style, short};

/// An event for machines.
#[derive(Serialize, Default, Debug)]
pub(super) struct Line {
    /// Nanoseconds since the start.
    pub(super) at_ns: u64,
    pub(super) class: &'static str,
    /// Where it was published.
    pub(super) segment: String,
    pub(super) tx_node: Option<u8>,
    pub(super) subject: String,
    pub(super) channel: Option<String>,
    /// Its number among the events of its sender, if that is known.
    pub(super) number: Option<u64>,
    /// So many before it did not come.
    pub(super) missing: u64,
    /// What is left to its deadline, negative if it is late; `None`: it has none, or nobody knows.
    pub(super) left_ns: Option<i64>,
    pub(super) data: String,
    pub(super) fields: Vec<DecodedField>,
    pub(super) malformed: Option<String>,
}

impl Line {
    /// An event as it was heard.
    pub(super) fn of(plan: Option<&SegmentPlan>, heard: &Heard, at_ns: u64) -> Self {
        let (fields, malformed) = content(plan, heard.subject, &heard.content);
        Self {
            at_ns,
            class: class_name(heard.class),
            segment: heard.origin.segment.to_string(),
            tx_node: heard.origin.node.map(|node| node.get()),
            subject: heard.subject.to_string(),
            channel: channel(plan, heard.subject),
            number: Some(heard.number),
            missing: heard.missing,
            left_ns: left(heard.deadline, heard.received_at),
            data: hex_text(&heard.content),
            fields,
            malformed,
        }
    }

    /// Prints it.
    pub(super) fn print(&self, context: &mut Context) -> Result<(), Failure> {
        if context.output.json() {
            context.output.value(self)?;
            return context.output.flush();
        }
        let at = context.output.styled(&format!("{:12.6}", self.at_ns as f64 / 1e9), Style::Dim);
        let style = if self.left_ns.is_some_and(|left| left < 0) { Style::Bad } else { Style::Plain };
        let left = context.output.styled(&format!("{:<14}", time_left(self.left_ns)), style);
        let number = self.number.map(|number| format!("#{number} ")).unwrap_or_default();
        let (class, place, channel) = (self.class, self.place(), self.label());
        context
            .output
            .line(&format!("{at}  {class}  {place:<12} {left} {channel} {number}{}", self.said()))?;
        context.output.flush()
    }

    pub(super) fn place(&self) -> String {
        place(&self.segment, self.tx_node)
    }

    pub(super) fn label(&self) -> &str {
        self.channel.as_deref().unwrap_or(&self.subject)
    }

    /// The content in words.
    pub(super) fn said(&self) -> String {
        match &self.malformed {
            Some(why) => format!("{} (malformed: {why})", self.data),
            None if self.fields.is_empty() => self.data.clone(),
            None => self.fields.iter().map(ToString::to_string).collect::<Vec<_>>().join(" "),
        }
    }
}

/// A node by its segment and TxNode there, or one on IP by its name.
pub(super) fn place(segment: &str, tx_node: Option<u8>) -> String {
    tx_node.map_or_else(|| segment.to_owned(), |node| format!("{segment}/{node:02X}"))
}

/// The name of a channel in the plan.
pub(super) fn channel(plan: Option<&SegmentPlan>, subject: Subject) -> Option<String> {
    let plan = plan?;
    Some(plan.channel(plan.channel_of_subject(subject)?).name.clone())
}

/// The fields of a content, or why it is none.
pub(super) fn content(
    plan: Option<&SegmentPlan>,
    subject: Subject,
    bytes: &[u8],
) -> (Vec<DecodedField>, Option<String>) {
    let at = plan.and_then(|plan| Some((plan, plan.channel_of_subject(subject)?)));
    match at.map(|(plan, at)| plan.decode(at, bytes)) {
        Some(Ok(fields)) => (fields, None),
        Some(Err(why)) => (Vec::new(), Some(why.to_string())),
        None => (Vec::new(), None),
    }
}

/// Nanoseconds to a deadline, negative behind it.
pub(super) fn left(deadline: Option<Instant>, at: Instant) -> Option<i64> {
    let ns = |span: cosmic_core::time::Duration| i64::try_from(span.as_ticks()).unwrap_or(i64::MAX);
    let deadline = deadline?;
    Some(if deadline >= at { ns(deadline.saturating_since(at)) } else { -ns(at.saturating_since(deadline)) })
}

pub(super) fn time_left(left_ns: Option<i64>) -> String {
    match left_ns {
        None => "-".to_owned(),
        Some(left) if left < 0 => format!("late {}", short(left.unsigned_abs())),
        Some(left) => format!("left {}", short(left.unsigned_abs())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::time::Duration;

    #[test]
    fn what_is_left_to_a_deadline_may_be_negative() {
        let at = |ms| Instant::from_epoch(Duration::from_millis(ms));
        assert_eq!(left(Some(at(50)), at(20)), Some(30_000_000));
        assert_eq!(left(Some(at(20)), at(50)), Some(-30_000_000));
        assert_eq!(time_left(left(Some(at(20)), at(50))), "late 30.0 ms");
        assert_eq!((left(None, at(50)), time_left(None)), (None, "-".to_owned()));
    }
}
