//! What is shown of the workshop.

use core::fmt;

use cosmic_plan::cluster::Cluster;

use super::names::{self, Bound, Name};
use super::promise::{self, Promise};
use super::{DESK_GOES, END, LAMP_STARTS_ANEW, Story};
use crate::columns::counted;
use crate::table::wrap;

/// What became of a run, ready to be printed.
#[derive(Clone, Debug)]
pub struct Summary {
    ids: Vec<Name>,
    bound: Vec<Bound>,
    /// What was promised.
    pub promises: Vec<Promise>,
    oddities: Vec<String>,
}

impl Summary {
    /// Of a run of this cluster.
    pub fn of(workshop: &Cluster, story: &Story) -> Self {
        let (ids, bound) = (names::ids(workshop, story), names::bound(workshop, story));
        let promises = promise::all(workshop, story, &ids, &bound);
        Self { ids, bound, promises, oddities: story.oddities.clone() }
    }

    /// Returns whether all promises were kept, and no node did what none should.
    pub fn passed(&self) -> bool {
        self.oddities.is_empty() && self.promises.iter().all(|promise| promise.is_kept)
    }

    fn names(&self) -> String {
        let one = |name: &Name| format!("{} {} ({} ms)", name.node, name.tx_node.get(), name.after);
        self.ids.iter().map(one).collect::<Vec<_>>().join(", ")
    }

    fn etags(&self) -> String {
        let one = |bound: &Bound| {
            let channel = bound.channel.as_deref().unwrap_or("in no plan");
            format!("{:X} ({channel}) {}", bound.subject, bound.etag.get())
        };
        self.bound.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = |millisecond: u64| millisecond as f64 / 1e3;
        writeln!(f, "beside it: the workshop, a cluster that configures itself")?;
        let line = format!(
            "{:.1} virtual seconds; at {:.1} s the desk, which names nodes and channels, is switched off, at {:.1} s the \
             lamp is started anew.",
            seconds(END),
            seconds(DESK_GOES),
            seconds(LAMP_STARTS_ANEW)
        );
        wrap(f, &line)?;
        wrap(f, &format!("ids, and how long after its start a node had its own: {}.", self.names()))?;
        wrap(f, &format!("subjects bound to etags: {}.", self.etags()))?;
        for promise in &self.promises {
            let mark = if promise.is_kept { "" } else { "BROKEN: " };
            wrap(f, &format!("{mark}{}", promise.text))?;
        }
        for oddity in &self.oddities {
            wrap(f, &format!("BROKEN: {oddity}"))?;
        }
        let broken = self.oddities.len() + self.promises.iter().filter(|promise| !promise.is_kept).count();
        match broken {
            0 => writeln!(f, "PASSED: all as promised."),
            _ => writeln!(f, "FAILED: {} not kept.", counted(broken as u64, "promise")),
        }
    }
}
