//! Commands from west to east, all the time, while the way between is open, cut, and open again.

use std::time::{Duration as Span, Instant};

use cosmic_core::Subject;
use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_linux::What;
use cosmic_wan::State;
use serde::Serialize;

use crate::bed::{Bed, COMMAND_ETAG, Failed, name};

/// How long a command is of use.
pub const VALIDITY: Span = Span::from_millis(300);

/// A command: when it was published, and when its frame was on the far bus, in seconds.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Command {
    /// When it was published.
    pub published: f64,
    /// When its frame was on the far bus.
    pub arrived: Option<f64>,
}

/// What became of the commands.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Story {
    /// When the way was cut, and when it healed, in seconds.
    pub cut: (f64, f64),
    /// All commands.
    pub commands: Vec<Command>,
    /// Frames on the far bus beyond one for each command.
    pub twice: usize,
    /// Frames of temperatures that were on the far bus before the cut, and after it: from an emulated sensor to an
    /// emulated brake.
    pub temperatures: (usize, usize),
}

impl Story {
    /// Commands that were stale when the way healed, and reached the far bus all the same.
    pub fn stale(&self) -> Vec<usize> {
        let limit = self.cut.1 - VALIDITY.as_secs_f64();
        let is_stale = |command: &Command| {
            command.published > self.cut.0 + MARGIN && command.published < limit && command.arrived.is_some()
        };
        self.commands.iter().enumerate().filter(|(_, it)| is_stale(it)).map(|(at, _)| at).collect()
    }

    /// Commands that arrived, of those published before the cut, during it, after it.
    pub fn arrived(&self) -> [(usize, usize); 3] {
        let mut parts = [(0, 0); 3];
        for command in &self.commands {
            let part =
                usize::from(command.published >= self.cut.0) + usize::from(command.published >= self.cut.1);
            parts[part].0 += usize::from(command.arrived.is_some());
            parts[part].1 += 1;
        }
        parts
    }

    /// How long after the way had healed the first command arrived, in seconds.
    pub fn back_after(&self) -> Option<f64> {
        let arrivals = self.commands.iter().filter_map(|command| command.arrived);
        arrivals.filter(|at| *at > self.cut.1).min_by(f64::total_cmp).map(|at| at - self.cut.1)
    }
}

/// What was published just before the cut may be under way.
const MARGIN: f64 = 0.1;
const TEMPERATURE: Subject = Subject::new(0xC05A_1C00_0000_0002).unwrap();

fn channel() -> Result<(Channel<u32>, Etag), Failed> {
    let wrong = || Failed("the demo's channels are wrong".to_owned());
    let quality =
        SoftAttributes { deadline: Duration::from_millis(100), validity: Duration::from_millis(300) };
    let etag = Etag::new(COMMAND_ETAG).ok_or_else(wrong)?;
    let subject = Subject::new(0xC05A_1C00_0000_00C0).ok_or_else(wrong)?;
    Ok((Channel::soft(subject, quality).with_etag(etag), etag))
}

/// Publishes every 20 ms; the way is open for a third of `around` before and after the cut.
///
/// # Errors
/// A channel is refused.
pub async fn tell(bed: &Bed, around: Span, cut: Span) -> Result<Story, Failed> {
    let (channel, etag) = channel()?;
    let far = bed.east.node(71)?;
    let _subscriber = far.subscribe(&channel, Policy::Latest).map_err(|error| Failed(error.to_string()))?;
    let near = bed.west.node(72)?;
    let publisher = near.announce(&channel).map_err(|error| Failed(error.to_string()))?;
    publisher.bound().await;
    let tap = bed.east.tap();
    let node = bed.of_east.node(&name("east")?);
    let temperature = node.and_then(|node| node.etag_of(TEMPERATURE));
    let begun = Instant::now();
    let now = move || begun.elapsed().as_secs_f64();
    let (commands, mut story_cut) = (std::cell::RefCell::new(Vec::<Command>::new()), (0.0, 0.0));
    let heard = std::cell::RefCell::new((0_usize, [0_usize; 2]));
    let is_after = std::cell::Cell::new(false);
    let listen = async {
        loop {
            let What::Frame(frame) = tap.next().await.what else { continue };
            let mut heard = heard.borrow_mut();
            if frame.id.tx_node().get() != 100 {
                continue;
            }
            if frame.id.etag() == etag {
                let Ok(number) = frame.payload.as_slice().try_into().map(u32::from_be_bytes) else {
                    continue;
                };
                if let Some(command) = commands.borrow_mut().get_mut(number as usize) {
                    heard.0 += usize::from(command.arrived.is_some());
                    command.arrived.get_or_insert(now());
                }
            } else if temperature == Some(frame.id.etag()) {
                heard.1[usize::from(is_after.get())] += 1;
            }
        }
    };
    let publish = async {
        loop {
            let number = commands.borrow().len() as u32;
            commands.borrow_mut().push(Command { published: now(), arrived: None });
            // One that is refused does not arrive.
            let _ = publisher.publish(number);
            tokio::time::sleep(Span::from_millis(20)).await;
        }
    };
    let act = async {
        tokio::time::sleep(around).await;
        story_cut.0 = now();
        bed.way.set(State::Cut);
        tokio::time::sleep(cut).await;
        story_cut.1 = now();
        bed.way.set(State::Open);
        is_after.set(true);
        tokio::time::sleep(around).await;
    };
    tokio::select! {
        () = listen => {}
        () = publish => {}
        () = act => {}
    }
    let (twice, [before, after]) = heard.into_inner();
    Ok(Story { cut: story_cut, commands: commands.into_inner(), twice, temperatures: (before, after) })
}
