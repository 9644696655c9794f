//! `cosmic echo`: events as they cross the bus, in words.

use std::process::ExitCode;

use cosmic_core::time::Instant;
use cosmic_linux::What;
use cosmic_log::feed;
use cosmic_monitor::Decoded;
use serde::Serialize;

use super::warn;
use crate::arguments::Echo;
use crate::context::Context;
use crate::failure::Failure;
use crate::output::Style;

/// An event for machines.
#[derive(Serialize)]
pub(super) struct Line<'a> {
    /// Nanoseconds since the start.
    at_ns: u64,
    #[serde(flatten)]
    decoded: &'a Decoded,
}

pub(super) async fn echo(context: &mut Context, options: &Echo) -> Result<ExitCode, Failure> {
    let chosen = context.chosen(&options.channels)?;
    let mut source = context.source(options.span).await?;
    let mut monitor = context.informed_monitor(source.now());
    let mut printed = 0;
    while options.count.is_none_or(|count| printed < count) {
        let Some(tapped) = source.next().await else { break };
        let tapped = tapped?;
        warn(&tapped);
        feed(&mut monitor, &tapped);
        let What::Frame(frame) = tapped.what else { continue };
        let etag = frame.id.etag();
        let wanted = if etag.is_reserved() { options.control } else { chosen.has(&monitor, etag) };
        // A message is printed with its last frame.
        if let Some(decoded) = monitor.decode_whole(&frame).filter(|_| wanted) {
            print(context, tapped.at, &decoded)?;
            printed += 1;
        }
    }
    let messages = monitor.snapshot(source.now()).messages;
    if messages.dropped > 0 {
        eprintln!("cosmic: {} messages had frames missing, and are not shown", messages.dropped);
    }
    Ok(context.ended(printed > 0, "no event was heard; `cosmic channels` shows what there is"))
}

/// One event, with the time since the start.
pub(super) fn print(context: &mut Context, at: Instant, decoded: &Decoded) -> Result<(), Failure> {
    let at_ns = at.since_epoch().as_ticks();
    if context.output.json() {
        return context.output.value(&Line { at_ns, decoded });
    }
    let at = context.output.styled(&format!("{:12.6}", at_ns as f64 / 1e9), Style::Dim);
    context.output.line(&format!("{at}  {decoded}"))
}
