//! `cosmic record`, `replay` and `decode`.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::time::Instant;
use cosmic_linux::What;
use cosmic_linux::link::LinkAddress;
use cosmic_log::{Heard, Writer};

use super::{echo, warn};
use crate::arguments::{Record, Replay};
use crate::context::Context;
use crate::failure::{FOUND, Failure};
use crate::source::{Source, std_span};

/// `cosmic record`
pub(super) async fn record(context: &mut Context, options: &Record) -> Result<ExitCode, Failure> {
    let mut source = context.source(options.span).await?;
    let mut writer = Writer::create(&options.file)?;
    let (mut frames, mut lost, mut untold) = (0_u64, 0_u64, 0_u64);
    while options.count.is_none_or(|count| frames < count) {
        let Some(tapped) = source.next().await else { break };
        let tapped = tapped?;
        warn(&tapped);
        let frame = match tapped.what {
            What::Frame(frame) => WireFrame::from(frame),
            What::Foreign(Some(frame)) => frame,
            What::Foreign(None) => {
                untold += 1;
                continue;
            }
            What::Lost(count) => {
                lost += u64::from(count);
                continue;
            }
            _ => continue,
        };
        writer.write(source.wall(tapped.at), &frame)?;
        frames += 1;
    }
    writer.flush()?;
    let mut told = format!("{frames} frames recorded, {lost} lost");
    if untold > 0 {
        told += &format!(", {untold} of a kind that this link does not show");
    }
    eprintln!("cosmic: {told}");
    Ok(if frames > 0 && lost == 0 { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

/// `cosmic replay`
pub(super) async fn replay(context: &mut Context, options: &Replay) -> Result<ExitCode, Failure> {
    let log = Source::open(&LinkAddress::Log(options.file.clone()), context.bit_rate())?;
    let mut target = Source::open(context.link()?, context.bit_rate())?;
    let patience = std_span(options.patience);
    target.connected(patience).await?;
    let Source::Live { tap, .. } = &mut target else {
        return Err(Failure::input(
            "a log cannot be sent to: give a link to a segment, such as --link sim:PATH",
        ));
    };
    let mut log = log;
    let start = tokio::time::Instant::now();
    let (mut sent, mut skipped) = (0_u64, 0_u64);
    while let Some(tapped) = log.next().await {
        let tapped = tapped?;
        let What::Frame(frame) = tapped.what else {
            skipped += 1;
            continue;
        };
        if options.speed > 0.0 {
            let since = std_span(tapped.at.since_epoch());
            let due =
                Duration::try_from_secs_f64(since.as_secs_f64() / options.speed).unwrap_or(Duration::MAX);
            let due = start.checked_add(due);
            tokio::select! {
                () = crate::source::sleep_until(due) => {}
                _ = tokio::signal::ctrl_c() => break,
            }
        }
        // What arrives meanwhile is of no interest here.
        while tap.try_next().is_some() {}
        if let Err(why) = tap.send(frame).await {
            return Err(Failure::link(format!("{why}; {sent} frames were sent before")));
        }
        sent += 1;
    }
    let mut told = format!("{sent} frames sent");
    if skipped > 0 {
        told += &format!(", {skipped} entries skipped that are no frames of COSMIC's");
    }
    eprintln!("cosmic: {told}");
    Ok(if sent > 0 { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

/// `cosmic decode`
pub(super) fn decode(context: &mut Context, file: &Path) -> Result<ExitCode, Failure> {
    let mut log = Heard::open(file, context.monitor(Instant::EPOCH))?;
    let mut frames = 0_u64;
    while let Some(entry) = log.next() {
        let (_, tapped) = entry?;
        if let What::Frame(frame) = tapped.what {
            frames += 1;
            echo::print(context, tapped.at, &log.monitor().decode(&frame))?;
        }
    }
    if frames == 0 && !context.output.json() {
        eprintln!("cosmic: there is no frame of COSMIC's in {}", file.display());
    }
    Ok(if frames > 0 { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}
