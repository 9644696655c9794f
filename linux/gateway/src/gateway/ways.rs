//! The ways of channels between a gateway's segments and IP: opened and closed as they are wanted.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration as Span;

use cosmic_core::can::Payload;
use cosmic_linux::Subscriber;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use zenoh::sample::{Locality, Sample};

use super::hub::Hub;
use super::messages::Assembly;
use super::origins::Declared;
use crate::error::StartError;
use crate::keys::Name;
use crate::network::{Network, Voice, failed};
use crate::segment::Leaving;

/// All that is open. It closes when it is dropped.
struct Ways {
    hub: Arc<Hub>,
    /// By segment: while we speak for it, and a while longer.
    voices: Vec<Option<Spoken>>,
    /// By segment and channel: while somebody elsewhere wants it, and a while longer.
    readers: HashMap<(usize, usize), Watched>,
    /// By channel: while somebody on segments that have a voice wants it.
    from_ip: HashMap<usize, zenoh::pubsub::Subscriber<()>>,
    /// Keys of what comes from there.
    declared: Declared,
}

/// That we speak for a segment.
struct Spoken {
    _voice: Voice,
    since: Instant,
    /// Since when we do not, any more.
    silent_since: Option<Instant>,
    /// It was looked whether another does so, too.
    is_checked: bool,
}

impl Spoken {
    fn new(voice: Voice) -> Self {
        Self { _voice: voice, since: Instant::now(), silent_since: None, is_checked: false }
    }

    /// We do not lead the segment. Returns whether that is so for long enough.
    fn is_over(&mut self) -> bool {
        self.silent_since.get_or_insert_with(Instant::now).elapsed() >= HESITATION
    }

    /// We lead the segment.
    fn go_on(&mut self, segment: &Name, network: &Network) {
        self.silent_since = None;
        // Who led before is not heard any more by then.
        if self.is_checked || self.since.elapsed() < 2 * HESITATION {
            return;
        }
        self.is_checked = true;
        if network.peers.speaking_for(segment) > 0 {
            tracing::warn!(
                "another gateway speaks for a segment {segment} too: each segment needs a name of its own"
            );
        }
    }
}

/// A channel that is read on a segment.
struct Watched {
    /// `None`: the segment refuses it.
    reader: Option<Reader>,
    /// Since when nobody wants it any more.
    unwanted_since: Option<Instant>,
}

/// A task that ends with it.
struct Reader(JoinHandle<()>);

impl Drop for Reader {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Keeps the ways, for ever.
///
/// # Errors
/// zenoh refuses one.
pub(super) async fn keep(hub: Arc<Hub>) -> Result<(), StartError> {
    let voices = hub.segments.iter().map(|_| None).collect();
    let mut ways =
        Ways { hub, voices, readers: HashMap::new(), from_ip: HashMap::new(), declared: Declared::default() };
    loop {
        ways.look().await?;
        let timer = tokio::time::sleep(LONGEST_DELAY);
        tokio::select! {
            () = ways.hub.changed.notified() => {}
            () = timer => {}
        }
    }
}

impl Ways {
    /// Opens and closes what has changed. Work: a look at each channel of each segment.
    async fn look(&mut self) -> Result<(), StartError> {
        for segment in 0..self.hub.segments.len() {
            self.keep_voice(segment).await?;
        }
        for (segment, channel) in self.readers.keys() {
            self.hub.segments[*segment].count_overflows(*channel);
        }
        let Hub { origins, channels, network, .. } = &*self.hub;
        self.declared.keep(origins, channels, network).await;
        for channel in 0..self.hub.channels.len() {
            let wanting: Vec<bool> = self.hub.segments.iter().map(|segment| segment.wants(channel)).collect();
            let all = wanting.iter().filter(|wants| **wants).count();
            for (segment, wants) in wanting.iter().enumerate() {
                self.keep_reader(segment, channel, all > usize::from(*wants));
            }
            self.keep_subscriber(channel, self.listens(channel)).await?;
        }
        Ok(())
    }

    async fn keep_voice(&mut self, at: usize) -> Result<(), StartError> {
        let (segment, network) = (&self.hub.segments[at], &self.hub.network);
        let voice = &mut self.voices[at];
        if !segment.leads() {
            if voice.as_mut().is_some_and(Spoken::is_over) {
                *voice = None;
            }
        } else if let Some(spoken) = voice {
            spoken.go_on(&segment.name, network);
        } else {
            let spoken = network.speak_for(&segment.name).await.map_err(StartError::Network)?;
            *voice = Some(Spoken::new(spoken));
        }
        Ok(())
    }

    /// Somebody on a segment wants the channel, and we speak for it or did so a moment ago.
    fn listens(&self, channel: usize) -> bool {
        let mut spoken_for = self.hub.segments.iter().zip(&self.voices).filter(|(_, voice)| voice.is_some());
        spoken_for.any(|(segment, _)| segment.is_interested(channel))
    }

    fn keep_reader(&mut self, segment: usize, channel: usize, elsewhere: bool) {
        let Some(outlet) = &self.hub.outlets[segment][channel] else { return };
        let place = (segment, channel);
        if elsewhere || outlet.wanted.load(Ordering::Relaxed) {
            let reader = self.readers.remove(&place).map(|before| before.reader);
            let is_told = reader.is_some();
            let reader = reader.flatten().or_else(|| self.read(segment, channel, is_told));
            self.readers.insert(place, Watched { reader, unwanted_since: None });
        } else if let Some(watched) = self.readers.get_mut(&place)
            && watched.unwanted_since.get_or_insert_with(Instant::now).elapsed() >= LINGERING
        {
            self.readers.remove(&place);
        }
    }

    fn read(&self, segment: usize, channel: usize, is_told: bool) -> Option<Reader> {
        match self.hub.segments[segment].listen(channel) {
            Ok(subscriber) => {
                let read = read(Arc::clone(&self.hub), segment, channel, subscriber);
                Some(Reader(tokio::spawn(read)))
            }
            Err(why) => {
                let (name, of) = (&self.hub.channels[channel].name, &self.hub.segments[segment].name);
                if !is_told {
                    tracing::warn!("segment {of}: the channel {name:?} cannot be subscribed to: {why}");
                }
                None
            }
        }
    }

    async fn keep_subscriber(&mut self, channel: usize, wanted: bool) -> Result<(), StartError> {
        if !wanted {
            self.from_ip.remove(&channel);
        } else if !self.from_ip.contains_key(&channel) {
            let hub = Arc::downgrade(&self.hub);
            let on_sample = move |sample: Sample| {
                if let Some(hub) = hub.upgrade() {
                    hub.on_sample(channel, &sample);
                }
            };
            let network = &self.hub.network;
            let key = network.keys.events(self.hub.channels[channel].subject);
            let subscriber = network.session.declare_subscriber(key).allowed_origin(Locality::Remote);
            let subscriber = subscriber.callback(on_sample).await;
            let subscriber = subscriber.map_err(|error| StartError::Network(failed(&error)))?;
            self.from_ip.insert(channel, subscriber);
        }
        Ok(())
    }
}

async fn read(hub: Arc<Hub>, segment: usize, channel: usize, subscriber: Subscriber<Payload>) {
    let of = &hub.segments[segment];
    let Some(mut messages) = hub.channels[channel].longest_message.map(|_| Assembly::new()) else {
        loop {
            hub.on_event(segment, channel, Leaving::from(&subscriber.next().await));
        }
    };
    loop {
        let Ok(event) = tokio::time::timeout(LONGEST_DELAY, subscriber.next()).await else {
            messages.on_time(of.node.now(), &of.outgoing);
            continue;
        };
        if let Some(leaving) = messages.on_frame(&event, &of.outgoing) {
            hub.on_event(segment, channel, leaving);
        }
    }
}

/// So long a channel is read that nobody wants any more: what a cut keeps away is counted, and the way is open again at
/// once behind it.
const LINGERING: Span = Span::from_secs(60);
/// So long a gateway keeps its ways that does not lead any more. On a machine that is busy it may lead again in a moment;
/// to declare everything anew each time would keep it busy for good, and all others with it.
const HESITATION: Span = Span::from_secs(5);
/// Not every change is told of.
const LONGEST_DELAY: Span = Span::from_secs(1);
