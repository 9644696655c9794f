//! One function for each command.

mod broker;
mod echo;
mod listen;
mod logs;
mod measure;
pub(crate) mod part;
mod serve;
mod served;

use std::process::ExitCode;

use clap::CommandFactory as _;
use cosmic_linux::{Tapped, What};
use cosmic_log::feed;
use cosmic_monitor::{Monitor, SegmentPlan};

use crate::arguments::{Arguments, Command};
use crate::choice::Choice;
use crate::context::Context;
use crate::failure::Failure;
use crate::output::Output;
use crate::source::Source;
use crate::top;

/// Runs a command.
pub(crate) async fn run(arguments: Arguments) -> Result<ExitCode, Failure> {
    let Arguments { common, command } = arguments;
    if let Command::Completions { shell } = command {
        clap_complete::generate(shell, &mut Arguments::command(), "cosmic", &mut std::io::stdout());
        return Ok(ExitCode::SUCCESS);
    }
    let plan = common.cluster.as_ref().map(SegmentPlan::read).transpose();
    let plan = plan.map_err(|refused| Failure::input(refused.to_string()))?;
    let output = Output::new(common.json);
    let mut context = Context { common, plan, output };
    let ended = match context.common.link.clone() {
        Some(Choice::Ip(at)) if command.takes_link() => across_ip(&mut context, &at, command).await,
        _ => of_a_bus(&mut context, command).await,
    };
    let flushed = context.output.flush();
    let code = ended?;
    flushed?;
    Ok(code)
}

#[cfg(feature = "ip")]
use crate::ip::run as across_ip;

#[cfg(not(feature = "ip"))]
async fn across_ip(_: &mut Context, _: &crate::choice::Endpoint, _: Command) -> Result<ExitCode, Failure> {
    Err(Failure::input(
        "this `cosmic` was built without IP: build it with the feature `ip`, which is on by default",
    ))
}

async fn of_a_bus(context: &mut Context, command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Nodes(options) => listen::nodes(context, &options).await,
        Command::Channels(options) => listen::channels(context, &options).await,
        Command::Doctor(options) => listen::doctor(context, &options).await,
        Command::Echo(options) => echo::echo(context, &options).await,
        Command::Hz(options) => measure::hz(context, &options).await,
        Command::Latency(options) => measure::latency(context, &options).await,
        Command::Top(options) => top::run(context, &options).await,
        Command::Serve(options) => serve::serve(context, &options).await,
        Command::Record(options) => logs::record(context, &options).await,
        Command::Replay(options) => logs::replay(context, &options).await,
        Command::Decode { file } => logs::decode(context, &file),
        Command::Sub(options) => part::subscribe(context, &options).await,
        Command::Pub(options) => part::publish(context, &options).await,
        Command::Broker(options) => broker::broker(context, &options).await,
        Command::Segment { path } => served::segment(context, &path).await,
        // What needs neither links nor this runtime is done already.
        Command::Completions { .. } => Ok(ExitCode::SUCCESS),
        #[cfg(feature = "ip")]
        Command::Gateway(_) => Ok(ExitCode::SUCCESS),
    }
}

/// Feeds a monitor with all that comes, to the end.
async fn listen(source: &mut Source, monitor: &mut Monitor) -> Result<(), Failure> {
    while let Some(tapped) = source.next().await {
        let tapped = tapped?;
        warn(&tapped);
        feed(monitor, &tapped);
    }
    Ok(())
}

/// Says what a person should know of the link.
fn warn(tapped: &Tapped) {
    match &tapped.what {
        What::Disconnected { why, ends: false } => eprintln!("cosmic: {why}; trying again"),
        What::Disconnected { why, ends: true } => eprintln!("cosmic: {why}"),
        _ => {}
    }
}
