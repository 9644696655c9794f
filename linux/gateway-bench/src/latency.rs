//! Latency: from the frame on one wire to the frame on the other, beside zenoh alone and the link alone, in one run.

use std::fmt;
use std::path::Path;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration as Span, Instant};

use cosmic_gateway::clock::Reading;
use serde::Serialize;

use crate::alone::{ECHO, PAUSE, Zenoh};
use crate::child::Child;
use crate::config::{Channel, Setup, etag_of, free_port};
use crate::failed::Failed;
use crate::gateways;
use crate::wire::{Wire, content};

/// Quantiles of one way, in microseconds.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Quantiles {
    /// How many were measured.
    pub count: usize,
    /// Half of them took no longer.
    pub median: f64,
    /// 99 of 100 took no longer.
    pub of_99: f64,
    /// None took longer.
    pub max: f64,
    /// The least median of a batch: what it is when others leave the machine alone.
    pub quietest: f64,
}

impl Quantiles {
    /// Of batches, in nanoseconds. `None` if one is empty.
    pub fn of(batches: &[Vec<u64>]) -> Option<Self> {
        let middle = |sorted: &[u64]| sorted.get(sorted.len() / 2).map(|&it| it as f64 / 1e3);
        let sorted = |batch: &Vec<u64>| {
            let mut batch = batch.clone();
            batch.sort_unstable();
            batch
        };
        let medians: Option<Vec<f64>> = batches.iter().map(|batch| middle(&sorted(batch))).collect();
        let all = sorted(&batches.concat());
        Some(Self {
            count: all.len(),
            median: middle(&all)?,
            of_99: all[(all.len() * 99 / 100).min(all.len() - 1)] as f64 / 1e3,
            max: *all.last()? as f64 / 1e3,
            quietest: medians?.into_iter().min_by(f64::total_cmp)?,
        })
    }
}

/// What was found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Latency {
    /// A frame in, a frame out: no node, no gateway.
    pub link: Quantiles,
    /// A put, and the subscriber.
    pub zenoh: Quantiles,
    /// From wire to wire, through two gateways.
    pub crossing: Quantiles,
    /// Events that did not arrive within a second.
    pub lost: usize,
}

impl Latency {
    /// What the two gateways add at the median, in microseconds: over the run, and in the quietest batches.
    pub fn added(&self) -> (f64, f64) {
        let of = |part: fn(&Quantiles) -> f64| part(&self.crossing) - part(&self.link) - part(&self.zenoh);
        (of(|it| it.median), of(|it| it.quietest))
    }
}

impl fmt::Display for Latency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "latency in µs, of {} events each, 8 bytes", self.crossing.count)?;
        let [a, b, c, d] = ["median", "99 %", "max", "quietest"];
        writeln!(f, "  {:<52} {a:>8} {b:>8} {c:>8} {d:>9}", "")?;
        for (what, it) in [
            ("the link alone: frame in, frame out", &self.link),
            ("zenoh alone: put, subscriber", &self.zenoh),
            ("CAN to CAN: link, gateway, zenoh, gateway, link", &self.crossing),
        ] {
            let Quantiles { median, of_99, max, quietest, .. } = it;
            writeln!(f, "  {what:<52} {median:>8.1} {of_99:>8.1} {max:>8.1} {quietest:>9.1}")?;
        }
        let (median, quietest) = self.added();
        writeln!(f, "  {:<52} {median:>8.1} {:>8} {:>8} {quietest:>9.1}", "the two gateways add", "", "")?;
        writeln!(f, "  lost: {}; quietest: the least median of a batch", self.lost)
    }
}

/// Measures so many events of each kind, in batches in turn, so that what else the machine does meets all of them.
///
/// # Errors
/// Something does not start, or nothing crosses.
pub fn measure(folder: &Path, batches: usize, each: usize) -> Result<Latency, Failed> {
    let mut link = link(folder)?;
    let mut zenoh = Zenoh::start(free_port()?)?;
    let mut crossing = crossing(folder)?;
    let (mut of_link, mut of_zenoh, mut of_crossing) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..batches {
        of_link.push(link.measure(each));
        of_zenoh.push(zenoh.measure(each)?);
        of_crossing.push(crossing.measure(each));
    }
    let nothing = |what: &str| Failed(format!("nothing comes back from {what}"));
    Ok(Latency {
        link: Quantiles::of(&of_link).ok_or_else(|| nothing("the link"))?,
        zenoh: Quantiles::of(&of_zenoh).ok_or_else(|| nothing("zenoh"))?,
        crossing: Quantiles::of(&of_crossing).ok_or_else(|| nothing("the gateways"))?,
        lost: link.lost + crossing.lost,
    })
}

/// A way from a wire to a wire.
struct Way {
    from: Wire,
    _to: Option<Wire>,
    heard: Receiver<u64>,
    lost: usize,
    _processes: Vec<Child>,
}

impl Way {
    /// How long each took, in nanoseconds.
    fn measure(&mut self, count: usize) -> Vec<u64> {
        let mut taken = Vec::with_capacity(count);
        for _ in 0..count {
            std::thread::sleep(PAUSE);
            match self.once() {
                Some(took) => taken.push(took),
                None => self.lost += 1,
            }
        }
        taken
    }

    fn once(&mut self) -> Option<u64> {
        // One that came too late.
        while self.heard.try_recv().is_ok() {}
        self.from.say(etag_of(0), Reading::now().0);
        self.heard.recv_timeout(Span::from_secs(1)).ok()
    }
}

fn link(folder: &Path) -> Result<Way, Failed> {
    let (tell, heard) = mpsc::channel();
    let from = Wire::serve(&folder.join("link"), move |frame, at| {
        // Nobody listens any more at the end.
        let _ = tell.send(at.0.saturating_sub(content(frame)));
    })?;
    let echo = Child::start(ECHO, &[from.path().display().to_string()])?;
    from.connected(PATIENCE)?;
    Ok(Way { from, _to: None, heard, lost: 0, _processes: vec![echo] })
}

fn crossing(folder: &Path) -> Result<Way, Failed> {
    let (tell, heard) = mpsc::channel();
    let from = Wire::serve(&folder.join("west"), |_, _| {})?;
    let to = Wire::serve(&folder.join("east"), move |frame, at| {
        if frame.id.etag() == etag_of(0) {
            let _ = tell.send(at.0.saturating_sub(content(frame)));
        }
    })?;
    let (port, other) = (free_port()?, free_port()?);
    let segment = |name: &str, wire: &Wire| vec![(name.to_owned(), wire.path().to_owned())];
    let (west, east) = (segment("west", &from), segment("east", &to));
    let channels = &[Channel::between(0, "west", "east")];
    let mode = "router";
    let west = Setup { mode, listen: Some(port), connect: None, segments: &west, channels };
    let east = Setup { mode, listen: Some(other), connect: Some(port), segments: &east, channels };
    let files = [west.write(folder, "west")?, east.write(folder, "east")?];
    let processes: Result<Vec<_>, _> = files.map(|file| gateways::start(&[file], None)).into_iter().collect();
    let mut way = Way { from, _to: Some(to), heard, lost: 0, _processes: processes? };
    let begun = Instant::now();
    way.from.connected(PATIENCE)?;
    while way.once().is_none() {
        if begun.elapsed() > PATIENCE {
            return Err(Failed("nothing crosses the gateways".to_owned()));
        }
    }
    Ok(way)
}

/// What does not begin by then, does not.
pub const PATIENCE: Span = Span::from_secs(60);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_batches() {
        let batches = [vec![3_000, 1_000, 2_000], vec![9_000, 4_000, 5_000]];
        let expected = Quantiles { count: 6, median: 4.0, of_99: 9.0, max: 9.0, quietest: 2.0 };
        assert_eq!(Quantiles::of(&batches), Some(expected));
        assert_eq!(Quantiles::of(&[vec![1], vec![]]), None);
    }

    #[test]
    fn what_gateways_add_is_what_is_left() {
        let of = |median, quietest| Quantiles { count: 1, median, of_99: 0.0, max: 0.0, quietest };
        let latency =
            Latency { link: of(10.0, 5.0), zenoh: of(50.0, 40.0), crossing: of(100.0, 60.0), lost: 0 };
        assert_eq!(latency.added(), (40.0, 15.0));
    }
}
