//! `cosmic top`: the segment on the whole terminal, drawn anew five times a second.
//!
//! Frames are taken as they come; only drawing has a rhythm. So a full bus costs no more drawing than an idle one.

mod draw;
mod screen;

use std::io::IsTerminal as _;
use std::process::ExitCode;
use std::time::Duration;

use cosmic_log::feed;
use cosmic_monitor::{Finding, Monitor, Notice, Snapshot};
use crossterm::event::{self, Event, KeyEventKind};
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior};

use crate::arguments::Top;
use crate::context::Context;
use crate::failure::Failure;
use crate::source::{Source, end_of, sleep_until};
use screen::{Answer, Screen};

/// What is drawn.
pub(crate) struct Shown<'a> {
    pub(crate) link: &'a str,
    pub(crate) snapshot: &'a Snapshot,
    pub(crate) findings: &'a [Finding],
    pub(crate) notices: &'a [Notice],
    pub(crate) names: &'a dyn Fn(u8) -> String,
    /// What a person should know of the link.
    pub(crate) trouble: Option<&'a str>,
}

pub(crate) async fn run(context: &mut Context, options: &Top) -> Result<ExitCode, Failure> {
    if !std::io::stdout().is_terminal() || context.output.json() {
        return Err(Failure::input(
            "top draws on a terminal, and this is none; `cosmic nodes`, `channels` and `doctor` print, with --json also \
             for machines",
        ));
    }
    let link = context.link()?.to_string();
    let mut source = context.source(None).await?.in_its_time();
    let mut monitor = context.monitor(source.now());
    let until = end_of(options.span);
    let mut terminal = ratatui::try_init().map_err(|error| {
        Failure::input(format!("the terminal cannot be drawn on: {error}; try another TERM"))
    })?;
    let ended = watch(&mut terminal, &mut source, &mut monitor, &link, until).await;
    ratatui::restore();
    ended.map(|()| ExitCode::SUCCESS)
}

async fn watch(
    terminal: &mut ratatui::DefaultTerminal,
    source: &mut Source,
    monitor: &mut Monitor,
    link: &str,
    until: Option<Instant>,
) -> Result<(), Failure> {
    let mut keys = keys();
    let mut screen = Screen::default();
    let mut tick = tokio::time::interval(REDRAW);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut trouble, mut has_ended): (Option<String>, bool) = (None, false);
    loop {
        tokio::select! {
            biased;
            () = sleep_until(until) => return Ok(()),
            key = keys.recv() => match key.map(|key| screen.on_key(&key)) {
                None | Some(Answer::Quit) => return Ok(()),
                Some(Answer::Stay) => {}
            },
            _ = tick.tick() => draw(terminal, monitor, &mut screen, link, source.now(), trouble.as_deref())?,
            next = source.next(), if !has_ended => match next {
                Some(Ok(tapped)) => {
                    trouble = told(&tapped.what).unwrap_or(trouble);
                    feed(monitor, &tapped);
                }
                Some(Err(failure)) => return Err(failure),
                None => {
                    has_ended = true;
                    trouble = Some("the log has ended".to_owned());
                }
            },
        }
    }
}

/// What is to be shown of the link, if that has changed.
fn told(what: &cosmic_linux::What) -> Option<Option<String>> {
    match what {
        cosmic_linux::What::Disconnected { why, .. } => Some(Some(why.to_string())),
        cosmic_linux::What::Connected => Some(None),
        _ => None,
    }
}

fn draw(
    terminal: &mut ratatui::DefaultTerminal,
    monitor: &mut Monitor,
    screen: &mut Screen,
    link: &str,
    now: cosmic_core::time::Instant,
    trouble: Option<&str>,
) -> Result<(), Failure> {
    let (findings, snapshot) = (monitor.doctor(now), monitor.snapshot(now));
    let notices: Vec<Notice> = monitor.notices(0).cloned().collect();
    let named = |number: u8| {
        let node = cosmic_core::can::TxNode::new(number).and_then(|node| monitor.name_of(node));
        node.unwrap_or_else(|| format!("{number:02X}"))
    };
    let shown =
        Shown { link, snapshot: &snapshot, findings: &findings, notices: &notices, names: &named, trouble };
    let drawn = terminal.draw(|frame| draw::draw(frame, screen, &shown));
    drawn.map(|_| ()).map_err(|error| Failure::input(format!("the terminal is gone: {error}")))
}

/// The keys that are pressed, from a thread of their own: reading them waits. It ends with the program.
pub(crate) fn keys() -> mpsc::Receiver<event::KeyEvent> {
    let (sender, receiver) = mpsc::channel(16);
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            if let Event::Key(key) = event
                && key.kind == KeyEventKind::Press
                && sender.blocking_send(key).is_err()
            {
                return;
            }
        }
    });
    receiver
}

const REDRAW: Duration = Duration::from_millis(200);
