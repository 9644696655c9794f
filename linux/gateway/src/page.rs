//! The gateway's live page: its segments, and what crosses.
//!
//! It only shows. Each segment is listened to by a link of its own, beside that of the gateway's node.

use std::time::{SystemTime, UNIX_EPOCH};

use cosmic_core::time::Instant;
use cosmic_linux::Tap;
use cosmic_monitor::{Monitor, class_name};
use cosmic_page::{Hub, Way};
use tokio::task::JoinSet;

use crate::config::{Config, SegmentConfig};
use crate::counters::Outcome;
use crate::crossing::Crossing;
use crate::error::StartError;

/// A page without segments, for a gateway.
pub(crate) fn hub(config: &Config, hosts: &[String]) -> Hub {
    let title = format!("gateway, network {}", config.network);
    Hub::new(cosmic_page::Config { title, hosts: hosts.to_vec(), publishing: None })
}

/// Shows the segments of a gateway on a page, as long as the set lives.
///
/// # Errors
/// A link that a segment cannot have.
pub(crate) fn show(hub: &Hub, config: &Config) -> Result<JoinSet<()>, StartError> {
    let mut listeners = JoinSet::new();
    for segment in &config.segments {
        let link = segment.link.link(segment.bit_rate);
        let link = link.map_err(|what| StartError::segment(&segment.name, what))?;
        let shown = hub.segment(segment.name.as_str(), segment.link.to_string(), monitor(segment));
        listeners.spawn(shown.follow(Tap::start(link)));
    }
    Ok(listeners)
}

fn monitor(segment: &SegmentConfig) -> Monitor {
    let mut monitor = match &segment.plan {
        Some(plan) => Monitor::with_plan(plan.clone(), Instant::EPOCH),
        None => Monitor::new(segment.bit_rate, Instant::EPOCH),
    };
    // Of fixed etags no frame on the bus says what they stand for.
    segment.etags.iter().for_each(|(subject, etag)| monitor.learn(*subject, *etag));
    monitor
}

/// An event that has just come, as the page shows it.
pub fn shown(crossing: &Crossing<'_>, outcome: Outcome) -> cosmic_page::Crossing {
    let channel = crossing.channel;
    let way = Way {
        channel: channel.name.clone(),
        subject: channel.subject.to_string(),
        class: class_name(channel.class).to_owned(),
        from: crossing.from.map(ToString::to_string).unwrap_or_default(),
        to: crossing.to.map_or_else(|| "IP".to_owned(), ToString::to_string),
        outcome: format!("{outcome:?}"),
        went: matches!(outcome, Outcome::Forwarded | Outcome::ForwardedLate),
    };
    let left_ns = crossing.to_deadline.map(|left| left.as_ticks());
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let at_ms = u64::try_from(since.as_millis()).unwrap_or(u64::MAX);
    cosmic_page::Crossing { at_ms, way, node: crossing.node.map(|node| node.get()), left_ns }
}
