//! `cosmic echo` across IP.

use std::process::ExitCode;

use super::words::Line;
use super::{Crossing, subjects};
use crate::arguments::Echo;
use crate::choice::Endpoint;
use crate::context::Context;
use crate::failure::Failure;

pub(super) async fn echo(context: &mut Context, at: &Endpoint, options: &Echo) -> Result<ExitCode, Failure> {
    if options.control {
        return Err(Failure::input("control messages do not cross IP: leave out --control"));
    }
    let subjects = subjects(context, &options.channels)?;
    let mut crossing = Crossing::listen(context, at, subjects.as_deref(), options.span).await?;
    let mut printed = 0;
    while options.count.is_none_or(|count| printed < count) {
        let Some(heard) = crossing.next().await else { break };
        let at_ns = crossing.since_start(heard.received_at);
        Line::of(context.plan.as_ref(), &heard, at_ns).print(context)?;
        printed += 1;
    }
    crossing.end().await;
    Ok(context.ended(printed > 0, "no event has crossed; `cosmic nodes` across IP shows who is there"))
}
