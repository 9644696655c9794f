//! The keys under which events come from IP: each is declared to our own session when the first event has come under it.
//!
//! zenoh remembers the way of an event with its key, if that is declared here. For any other it looks anew each time among
//! all that is declared, in each of its regions: longer than all else that becomes of an event here, and the longer the
//! more subjects there are. The sender has declared its key, but that is told no further than to the first router.
//!
//! A key stays declared while somebody speaks for its segment, and a while longer: so there are no more of them than
//! participants times channels, and [`MOST`].

use std::collections::{HashMap, HashSet};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration as Span;

use tokio::time::Instant;
use zenoh::key_expr::KeyExpr;

use crate::config::ChannelConfig;
use crate::keys::Name;
use crate::network::Network;

/// The segments from which events have come.
pub(super) struct Origins {
    /// By channel.
    known: Vec<Mutex<HashSet<Name>>>,
    /// Of these, what is not declared yet, with the channel.
    new: Mutex<Vec<(usize, Name)>>,
}

impl Origins {
    pub(super) fn new(channels: usize) -> Self {
        Self { known: (0..channels).map(|_| Mutex::default()).collect(), new: Mutex::default() }
    }

    /// An event of the channel has come from the segment. Returns whether that is new. O(1).
    pub(super) fn note(&self, channel: usize, segment: &Name) -> bool {
        let mut known = lock(&self.known[channel]);
        if known.contains(segment) {
            return false;
        }
        known.insert(segment.clone());
        lock(&self.new).push((channel, segment.clone()));
        true
    }

    fn forget(&self, segment: &Name) {
        for known in &self.known {
            lock(known).remove(segment);
        }
    }
}

/// What is declared, by segment.
#[derive(Default)]
pub(super) struct Declared {
    of: HashMap<Name, OfSegment>,
    count: usize,
}

#[derive(Default)]
struct OfSegment {
    keys: Vec<KeyExpr<'static>>,
    /// Since when nobody speaks for it.
    silent_since: Option<Instant>,
}

impl Declared {
    /// Declares what is new, and gives up what is of no use any more. Work: a look at each segment, and what has changed.
    pub(super) async fn keep(&mut self, origins: &Origins, channels: &[ChannelConfig], network: &Network) {
        let new = std::mem::take(&mut *lock(&origins.new));
        for (channel, segment) in new {
            let key = network.keys.event(channels[channel].subject, &segment);
            // Also without a key it is known, and forgotten when nobody speaks for it any more.
            let of = self.of.entry(segment).or_default();
            // Events cross without, too.
            if self.count >= MOST {
                continue;
            }
            match network.session.declare_keyexpr(key).await {
                Ok(key) => {
                    of.keys.push(key);
                    self.count += 1;
                }
                Err(error) => tracing::debug!("a key is not declared: {error}"),
            }
        }
        let gone: Vec<Name> =
            self.of.iter_mut().filter_map(|(segment, of)| of.is_gone(segment, network)).collect();
        for segment in gone {
            let keys = self.of.remove(&segment).unwrap_or_default().keys;
            self.count -= keys.len();
            for key in keys {
                if let Err(error) = network.session.undeclare(key).await {
                    tracing::debug!("a key is not given up: {error}");
                }
            }
            origins.forget(&segment);
        }
    }
}

impl OfSegment {
    /// The segment, if nobody has spoken for it for long.
    fn is_gone(&mut self, segment: &Name, network: &Network) -> Option<Name> {
        if network.peers.speaking_for(segment) > 0 {
            self.silent_since = None;
            return None;
        }
        let since = self.silent_since.get_or_insert_with(Instant::now);
        (since.elapsed() >= LINGERING).then(|| segment.clone())
    }
}

fn lock<T>(it: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing in here panics; what is there is looked at as it is.
    it.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keys at once, at most: some ten megabytes.
const MOST: usize = 16_384;
/// So long a key stays declared when nobody speaks for its segment: a cut passes, and so does what is under way.
const LINGERING: Span = Span::from_secs(60);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_new_once_until_it_is_forgotten() {
        let origins = Origins::new(2);
        let [west, east] = ["west", "east"].map(|name| Name::new(name).unwrap());
        let noted = [(0, &west), (0, &west), (1, &west), (0, &east), (0, &east)];
        let new = noted.map(|(channel, segment)| origins.note(channel, segment));
        assert_eq!(new, [true, false, true, true, false]);
        let told = std::mem::take(&mut *lock(&origins.new));
        assert_eq!(told, [(0, west.clone()), (1, west.clone()), (0, east.clone())]);
        origins.forget(&west);
        assert_eq!([(1, &west), (0, &east)].map(|(channel, it)| origins.note(channel, it)), [true, false]);
    }
}
