//! `cosmic top` across IP: who is there, what crosses, and the last events, drawn five times a second.

use std::collections::VecDeque;
use std::io::IsTerminal as _;
use std::process::ExitCode;
use std::time::Duration;

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Style, Stylize as _};
use ratatui::text::Line as Text;
use ratatui::widgets::{Block, Paragraph, Row, Table};
use tokio::time::{Instant, MissedTickBehavior};

use super::Crossing;
use super::flows::{Flow, Flows};
use super::words::{Line, time_left};
use crate::arguments::Top;
use crate::choice::Endpoint;
use crate::context::Context;
use crate::failure::Failure;
use crate::output::short;
use crate::source::{end_of, sleep_until};

pub(super) async fn run(context: &mut Context, at: &Endpoint, options: &Top) -> Result<ExitCode, Failure> {
    if !std::io::stdout().is_terminal() || context.output.json() {
        return Err(Failure::input(
            "top draws on a terminal, and this is none; `cosmic nodes` and `channels` print, with --json also for machines",
        ));
    }
    let mut crossing = Crossing::listen(context, at, None, None).await?;
    let until = end_of(options.span);
    let mut terminal = ratatui::try_init().map_err(|error| {
        Failure::input(format!("the terminal cannot be drawn on: {error}; try another TERM"))
    })?;
    let ended = watch(&mut terminal, context, &mut crossing, at, until).await;
    ratatui::restore();
    crossing.end().await;
    ended.map(|()| ExitCode::SUCCESS)
}

async fn watch(
    terminal: &mut ratatui::DefaultTerminal,
    context: &Context,
    crossing: &mut Crossing,
    at: &Endpoint,
    until: Option<Instant>,
) -> Result<(), Failure> {
    let mut keys = crate::top::keys();
    let mut tick = tokio::time::interval(REDRAW);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut flows, mut last) = (Flows::default(), VecDeque::new());
    loop {
        tokio::select! {
            biased;
            () = sleep_until(until) => return Ok(()),
            key = keys.recv() => if key.is_none_or(|key| ends(&key)) { return Ok(()) },
            _ = tick.tick() => {
                let drawn = terminal.draw(|frame| draw(frame, crossing, &flows, &last, at));
                drawn.map_err(|error| Failure::input(format!("the terminal is gone: {error}")))?;
            }
            heard = crossing.listener.next() => {
                let at_ns = crossing.since_start(heard.received_at);
                flows.add(context.plan.as_ref(), &heard, at_ns);
                last.truncate(MOST_LAST - 1);
                last.push_front(Line::of(context.plan.as_ref(), &heard, at_ns));
            }
        }
    }
}

fn ends(key: &KeyEvent) -> bool {
    let interrupts = key.modifiers.contains(KeyModifiers::CONTROL) && key.code == KeyCode::Char('c');
    interrupts || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc)
}

fn draw(frame: &mut Frame<'_>, crossing: &Crossing, flows: &Flows, last: &VecDeque<Line>, at: &Endpoint) {
    let now_ns = crossing.since_start(crossing.listener.now());
    let all: Vec<&Flow> = flows.iter().collect();
    let height = u16::try_from(all.len() + 3).unwrap_or(u16::MAX);
    let parts = Layout::vertical([Constraint::Length(2), Constraint::Max(height), Constraint::Min(4)]);
    let [head, middle, bottom] = parts.areas(frame.area());
    frame.render_widget(Paragraph::new(heads(crossing, at)), head);
    frame.render_widget(table(&all, now_ns), middle);
    let lines: Vec<Text<'_>> = last.iter().map(event).collect();
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(" last events ")), bottom);
}

fn heads(crossing: &Crossing, at: &Endpoint) -> Vec<Text<'static>> {
    let speakers =
        crossing.listener.participants().into_iter().map(|participant| match participant.uncertainty {
            Some(uncertainty) => {
                format!("{} (clock to {})", participant.segment, short(uncertainty.as_ticks()))
            }
            None => format!("{} (clock unknown)", participant.segment),
        });
    let speakers: Vec<String> = speakers.collect();
    let there = if speakers.is_empty() { "nobody".to_owned() } else { speakers.join(", ") };
    let lost = crossing.listener.lost();
    vec![
        Text::from(format!("what crosses IP at {}   lost here: {lost}   q ends", at.as_str())).bold(),
        Text::from(format!("who speaks: {there}")),
    ]
}

fn table(flows: &[&Flow], now_ns: u64) -> Table<'static> {
    let rows = flows.iter().map(|flow| {
        let rate = flow.distances.events as f64 * 1e9 / now_ns.max(1) as f64;
        let late = if flow.late > 0 { Style::new().red().bold() } else { Style::new() };
        Row::new([
            flow.last.label().to_owned(),
            flow.last.class.to_owned(),
            flow.last.place(),
            format!("{rate:.1}"),
            flow.missing.to_string(),
            flow.late.to_string(),
            time_left(flow.least_left_ns),
            flow.last.said(),
        ])
        .style(late)
    });
    let widths = [20, 5, 14, 8, 7, 6, 13].map(Constraint::Length).into_iter().chain([Constraint::Min(10)]);
    let heads = ["CHANNEL", "CLASS", "PUBLISHER", "EVENTS/S", "MISSING", "LATE", "AT LEAST", "LAST"];
    Table::new(rows, widths).header(Row::new(heads).bold()).block(Block::bordered().title(" channels "))
}

fn event(line: &Line) -> Text<'static> {
    let (at, place, left) = (line.at_ns as f64 / 1e9, line.place(), time_left(line.left_ns));
    Text::from(format!("{at:12.6}  {}  {place:<14} {left:<13} {} {}", line.class, line.label(), line.said()))
}

const REDRAW: Duration = Duration::from_millis(200);
/// Events that are drawn at most.
const MOST_LAST: usize = 60;
