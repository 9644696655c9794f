//! One function for each command.

mod broker;
mod echo;
mod listen;
mod logs;
mod measure;
mod part;
mod serve;
mod served;

use std::process::ExitCode;

use clap::CommandFactory as _;
use cosmic_linux::{Tapped, What};
use cosmic_log::feed;
use cosmic_monitor::{Monitor, SegmentPlan};

use crate::arguments::{Arguments, Command};
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
    let ended = match command {
        Command::Nodes(options) => listen::nodes(&mut context, &options).await,
        Command::Channels(options) => listen::channels(&mut context, &options).await,
        Command::Doctor(options) => listen::doctor(&mut context, &options).await,
        Command::Echo(options) => echo::echo(&mut context, &options).await,
        Command::Hz(options) => measure::hz(&mut context, &options).await,
        Command::Latency(options) => measure::latency(&mut context, &options).await,
        Command::Top(options) => top::run(&mut context, &options).await,
        Command::Serve(options) => serve::serve(&mut context, &options).await,
        Command::Record(options) => logs::record(&mut context, &options).await,
        Command::Replay(options) => logs::replay(&mut context, &options).await,
        Command::Decode { file } => logs::decode(&mut context, &file),
        Command::Sub(options) => part::subscribe(&mut context, &options).await,
        Command::Pub(options) => part::publish(&mut context, &options).await,
        Command::Broker(options) => broker::broker(&mut context, &options).await,
        Command::Segment { path } => served::segment(&mut context, &path).await,
        Command::Completions { .. } => Ok(ExitCode::SUCCESS),
    };
    let flushed = context.output.flush();
    let code = ended?;
    flushed?;
    Ok(code)
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
