//! The other participants: who is there, and what their clocks say.
//!
//! A participant is a sender *in a segment*: access control binds the segment to a certificate, but a sender is only a
//! number, which another may use too. So each segment has room of its own, and what is said in one of them tells nothing
//! of the others.
//!
//! A clock is asked for each second while events come from there. Of those that only are there, so many that the questions
//! of all participants would grow with the square of their number, each is asked so seldom that a participant asks no more
//! than [20 questions a second](FOR_EACH_SILENT) of them, however many there are.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration as Span;

use cosmic_core::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinSet;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Locality, Sample, SampleKind};

use crate::clock::{Exchange, PeerClock, Reading};
use crate::counters::Outcome;
use crate::encoding::{Envelope, Sender};
use crate::keys::{Keys, Name, SenderKey};

/// What is known of the others.
pub(crate) struct Peers {
    known: Mutex<Known>,
    /// There is somebody whose clock is not known.
    ask: Notify,
}

/// By segment and sender.
type Known = HashMap<Name, HashMap<Sender, Peer>>;

struct Peer {
    clock: Option<PeerClock>,
    /// Tokens that it holds.
    tokens: u32,
    /// When it was last heard of.
    heard_at: Reading,
    /// When an event came from it last.
    event_at: Option<Reading>,
    asked_at: Option<Reading>,
    /// How often it was asked since then in vain, as far as is known.
    in_vain: u32,
}

impl Peer {
    const fn new(now: Reading) -> Self {
        Self { clock: None, tokens: 0, heard_at: now, event_at: None, asked_at: None, in_vain: 0 }
    }

    /// Between two questions to it, where one that is silent is asked so seldom.
    fn pause(&self, silent: Duration, now: Reading) -> Duration {
        let is_silent = self.event_at.is_none_or(|at| now.since(at) > LATELY);
        if self.clock.is_none() {
            Duration::from_ticks(
                BETWEEN_FIRST_QUESTIONS.as_ticks() << self.in_vain.saturating_sub(1).min(DOUBLINGS),
            )
        } else if is_silent {
            silent
        } else {
            BETWEEN_QUESTIONS
        }
    }
}

impl Peers {
    pub(super) fn new() -> Self {
        Self { known: Mutex::new(HashMap::new()), ask: Notify::new() }
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        // Nothing in here panics; what is there is looked at as it is.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Not less than the age of an event that has come, or why nobody knows it. O(1).
    pub(crate) fn age(&self, segment: &Name, envelope: &Envelope, now: Reading) -> Result<Duration, Outcome> {
        let mut known = self.lock();
        let of_segment = place(&mut known, segment).ok_or(Outcome::TooManySenders)?;
        if of_segment.len() >= MOST_SENDERS && !of_segment.contains_key(&envelope.sender) {
            return Err(Outcome::TooManySenders);
        }
        let peer = of_segment.entry(envelope.sender).or_insert_with(|| Peer::new(now));
        peer.heard_at = now;
        let was_silent = peer.event_at.replace(now).is_none_or(|at| now.since(at) > LATELY);
        // What is not answered is asked again in its time, however many events come meanwhile.
        if was_silent {
            self.ask.notify_one();
        }
        let Some(clock) = &peer.clock else { return Err(Outcome::AgeUnknown) };
        clock.age_at_most(envelope.sent_at, now).ok_or(Outcome::FromTheFuture)
    }

    /// The segments that are spoken for, each with how much more than the age of its events may be told; `None`: the clock
    /// is not known.
    pub(crate) fn speakers(&self, now: Reading) -> Vec<(Name, Option<Duration>)> {
        let known = self.lock();
        let speakers =
            known.iter().flat_map(|(segment, peers)| peers.values().map(move |peer| (segment, peer)));
        let uncertainty = |peer: &Peer| peer.clock.as_ref().map(|clock| clock.uncertainty(now));
        let speaks = speakers.filter(|(_, peer)| peer.tokens > 0);
        speaks.map(|(segment, peer)| (segment.clone(), uncertainty(peer))).collect()
    }

    /// Others that are there, and speak for this segment.
    pub(crate) fn speaking_for(&self, segment: &Name) -> usize {
        self.lock().get(segment).map_or(0, |it| it.values().filter(|peer| peer.tokens > 0).count())
    }

    /// How many others are there, and of how many the clock is known in each segment that they speak for.
    pub(crate) fn count(&self) -> (usize, usize) {
        let known = self.lock();
        let mut others: HashMap<Sender, (bool, bool)> = HashMap::new();
        for (sender, peer) in known.values().flatten() {
            let (is_there, has_clock) = others.entry(*sender).or_insert((false, true));
            *is_there |= peer.tokens > 0;
            *has_clock &= peer.clock.is_some();
        }
        (others.values().filter(|it| it.0).count(), others.values().filter(|it| it.1).count())
    }

    fn on_token(&self, key: &SenderKey, alive: bool, now: Reading) {
        let mut known = self.lock();
        if !alive {
            if let Some(peer) = known.get_mut(&key.segment).and_then(|it| it.get_mut(&key.sender)) {
                peer.tokens = peer.tokens.saturating_sub(1);
                peer.heard_at = now;
            }
            return;
        }
        let Some(of_segment) = place(&mut known, &key.segment) else { return };
        if of_segment.len() >= MOST_SENDERS && !of_segment.contains_key(&key.sender) {
            // A number that has no token may be made up, or of one that is gone.
            let without = of_segment.iter().filter(|(_, peer)| peer.tokens == 0);
            let Some(silent) = without.min_by_key(|it| it.1.heard_at).map(|it| *it.0) else { return };
            of_segment.remove(&silent);
        }
        let peer = of_segment.entry(key.sender).or_insert_with(|| Peer::new(now));
        peer.tokens = peer.tokens.saturating_add(1);
        (peer.heard_at, peer.in_vain) = (now, 0);
        self.ask.notify_one();
    }

    fn note(&self, of: &SenderKey, exchange: Exchange) {
        if let Some(peer) = self.lock().get_mut(&of.segment).and_then(|it| it.get_mut(&of.sender)) {
            peer.in_vain = 0;
            match &mut peer.clock {
                Some(clock) => clock.note(exchange),
                None => peer.clock = Some(PeerClock::new(exchange)),
            }
        }
    }

    /// Who is to be asked now. Who was not heard of for long is forgotten.
    fn due(&self, now: Reading) -> Vec<SenderKey> {
        let mut known = self.lock();
        let mut due = Vec::new();
        let all = known.values().map(HashMap::len).sum::<usize>() as u64;
        let silent =
            LEAST_TO_SILENT.max(Duration::from_ticks(FOR_EACH_SILENT.as_ticks().saturating_mul(all)));
        known.retain(|segment, of_segment| {
            of_segment.retain(|_, peer| peer.tokens > 0 || now.since(peer.heard_at) < MEMORY);
            for (sender, peer) in of_segment.iter_mut() {
                let pause = peer.pause(silent, now);
                if peer.asked_at.is_none_or(|asked| now.since(asked) >= pause) {
                    peer.asked_at = Some(now);
                    peer.in_vain = peer.in_vain.saturating_add(1);
                    due.push(SenderKey { segment: segment.clone(), sender: *sender });
                }
            }
            !of_segment.is_empty()
        });
        due
    }
}

/// The senders of a segment; `None` if there is no room for one more segment.
fn place<'a>(known: &'a mut Known, segment: &Name) -> Option<&'a mut HashMap<Sender, Peer>> {
    if !known.contains_key(segment) {
        if known.len() >= MOST_SEGMENTS {
            return None;
        }
        known.insert(segment.clone(), HashMap::new());
    }
    known.get_mut(segment)
}

/// Watches who is there.
pub(super) async fn watch(
    session: &Session,
    keys: &Keys,
    me: Sender,
    peers: Arc<Peers>,
) -> zenoh::Result<Subscriber<()>> {
    let reader = keys.clone();
    let on_sample = move |sample: Sample| {
        let key = reader.read_live(sample.key_expr().as_str());
        if let Some(key) = key.filter(|key| key.sender != me) {
            peers.on_token(&key, sample.kind() == SampleKind::Put, Reading::now());
        }
    };
    session.liveliness().declare_subscriber(keys.all_live()).history(true).callback(on_sample).await
}

/// Keeps the clocks of the others known. The watcher lives as long, and so do the questions.
pub(super) async fn keep(session: Session, keys: Keys, peers: Arc<Peers>, watcher: Subscriber<()>) {
    let _watcher = watcher;
    let mut questions = JoinSet::new();
    loop {
        for key in peers.due(Reading::now()) {
            questions.spawn(ask(session.clone(), keys.clock(&key), key, Arc::clone(&peers)));
        }
        while questions.try_join_next().is_some() {}
        let pause = tokio::time::sleep(Span::from_millis(100));
        tokio::select! {
            () = pause => {}
            () = peers.ask.notified() => {}
        }
    }
}

async fn ask(session: Session, key: String, of: SenderKey, peers: Arc<Peers>) {
    let asked_at = Reading::now();
    let query = session.get(key).allowed_destination(Locality::Remote).timeout(PATIENCE);
    let Ok(replies) = query.await else { return };
    while let Ok(reply) = replies.recv_async().await {
        let received_at = Reading::now();
        let Ok(sample) = reply.result() else { continue };
        if let Ok(bytes) = <[u8; 8]>::try_from(&*sample.payload().to_bytes()) {
            let answered_at = Reading(u64::from_be_bytes(bytes));
            peers.note(&of, Exchange { asked_at, answered_at, received_at });
            return;
        }
    }
}

/// Between two questions to one whose clock is known, and whose events come.
const BETWEEN_QUESTIONS: Duration = Duration::from_secs(1);
/// So long after an event one does not count as silent.
const LATELY: Duration = Duration::from_secs(10);
/// Between two questions to one that is silent, at least: what its clock may have drifted by then makes an event a
/// thousandth of this older than it is.
const LEAST_TO_SILENT: Duration = Duration::from_secs(10);
/// And so much for each other that is there.
const FOR_EACH_SILENT: Duration = Duration::from_millis(50);
/// Between the first two questions to one whose clock is not known; then twice that, and so on.
const BETWEEN_FIRST_QUESTIONS: Duration = Duration::from_millis(200);
const DOUBLINGS: u32 = 4;
/// An answer that takes longer is of no use.
const PATIENCE: Span = Span::from_secs(5);
/// So long one without a token is known that was not heard of.
const MEMORY: Duration = Duration::from_secs(60);
/// Segments of others at once, at most.
const MOST_SEGMENTS: usize = 4096;
/// Senders at once in one of them, at most: gateways that were started within a minute.
const MOST_SENDERS: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::protocol::{Class, LayoutHash};

    fn name(text: &str) -> Name {
        Name::new(text).unwrap()
    }

    fn key(segment: &str, sender: u64) -> SenderKey {
        SenderKey { segment: name(segment), sender: Sender(sender) }
    }

    fn event(sender: u64, sent_at: u64) -> Envelope {
        Envelope {
            class: Class::Soft,
            node: None,
            layout: LayoutHash::UNSTATED,
            sender: Sender(sender),
            sequence: 1,
            sent_at: Reading(sent_at),
            to_deadline: None,
            to_expiry: None,
            content: Vec::new(),
        }
    }

    /// Asked at zero, answered at once.
    fn answer(says: u64) -> Exchange {
        Exchange { asked_at: Reading(0), answered_at: Reading(says), received_at: Reading(0) }
    }

    #[test]
    fn one_number_in_two_segments_is_two_senders() {
        let peers = Peers::new();
        let (west, east) = (key("west", 7), key("east", 7));
        // East's is heard of first, and says that its clock is far behind: what it stamps is of the future.
        peers.on_token(&east, true, Reading(0));
        peers.on_token(&west, true, Reading(0));
        let mut asked = peers.due(Reading(1));
        asked.sort_by(|one, other| one.segment.cmp(&other.segment));
        assert_eq!(asked, [east.clone(), west.clone()], "each is asked in its own segment");
        peers.note(&east, answer(0));
        assert_eq!(peers.age(&west.segment, &event(7, 500), Reading(600)), Err(Outcome::AgeUnknown));
        assert_eq!(peers.count(), (1, 0), "one of its clocks is not known");
        peers.note(&west, answer(400));
        let age = |segment| peers.age(segment, &event(7, 500), Reading(400));
        assert_eq!(age(&west.segment), Ok(Duration::from_ticks(300)));
        assert_eq!(age(&east.segment), Err(Outcome::FromTheFuture));
        assert_eq!((peers.count(), peers.speaking_for(&west.segment)), ((1, 1), 1));
        peers.on_token(&east, false, Reading(0));
        assert_eq!((peers.speaking_for(&east.segment), peers.speaking_for(&west.segment)), (0, 1));
    }

    #[test]
    fn made_up_numbers_fill_the_room_of_their_own_segment_only() {
        let peers = Peers::new();
        for made_up in 0..1000 {
            let _ = peers.age(&name("west"), &event(made_up, 0), Reading(made_up));
        }
        let age = |segment, sender| peers.age(&name(segment), &event(sender, 0), Reading(2000));
        assert_eq!(age("west", 5000), Err(Outcome::TooManySenders));
        assert_eq!(age("east", 5000), Err(Outcome::AgeUnknown));
        assert_eq!(peers.due(Reading(2000)).len(), MOST_SENDERS + 1, "and no more questions are asked");
        // Who shows a token takes the place of one that does not.
        peers.on_token(&key("west", 5000), true, Reading(2000));
        peers.note(&key("west", 5000), answer(0));
        assert_eq!(age("west", 5000), Ok(Duration::from_ticks(2000 + 2)));
        let later = Reading(2000 + MEMORY.as_ticks());
        let left: Vec<_> = peers.due(later).into_iter().map(|it| it.sender).collect();
        assert_eq!(left, [Sender(5000)], "who has none is forgotten");
    }

    #[test]
    fn questions_to_those_that_are_silent_do_not_grow_with_their_number() {
        const SECOND: u64 = 1_000_000_000;
        for others in [10, 400, 4000] {
            let peers = Peers::new();
            for number in 0..others {
                let key = key(&format!("segment-{number}"), number);
                peers.on_token(&key, true, Reading(0));
                peers.note(&key, answer(0));
            }
            assert_eq!(peers.due(Reading(SECOND)).len() as u64, others, "each is asked first of all");
            // Events come from one of them, all the time.
            let (mut asked, mut of_it) = (0, 0);
            for second in 2..=402 {
                let now = Reading(second * SECOND);
                assert!(peers.age(&name("segment-3"), &event(3, now.0), now).is_ok());
                let due = peers.due(now);
                asked += due.len();
                of_it += due.iter().filter(|key| key.sender == Sender(3)).count();
            }
            assert!(asked - of_it <= 20 * 401, "{others}: {asked} in 401 s");
            assert_eq!(of_it, 401, "its clock is asked for each second");
        }
    }

    #[test]
    fn who_does_not_answer_is_asked_less_and_less() {
        let peers = Peers::new();
        peers.on_token(&key("west", 7), true, Reading(0));
        let asked_at = |milliseconds: u64| !peers.due(Reading(milliseconds * 1_000_000)).is_empty();
        let asked: Vec<u64> = (0..10_000).step_by(100).filter(|at| asked_at(*at)).collect();
        assert_eq!(asked, [0, 200, 600, 1400, 3000, 6200, 9400]);
        // It is there again.
        peers.on_token(&key("west", 7), true, Reading(0));
        assert!(asked_at(9600));
    }

    #[test]
    fn segments_are_bounded_too() {
        let peers = Peers::new();
        let age = |segment: usize| {
            let segment = Name::new(&format!("made-up-{segment}")).unwrap();
            peers.age(&segment, &event(1, 0), Reading(1))
        };
        assert!((0..MOST_SEGMENTS).all(|number| age(number) == Err(Outcome::AgeUnknown)));
        assert_eq!(age(MOST_SEGMENTS), Err(Outcome::TooManySenders));
    }
}
