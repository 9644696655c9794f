//! The browsers that watch: a bounded queue to each.

use std::sync::Arc;

use serde::Serialize;
use tokio::sync::mpsc;

use crate::messages::Lost;

/// So many messages wait for a browser: some seconds.
pub const QUEUE: usize = 64;
/// So many browsers may watch at once.
pub const MOST_BROWSERS: usize = 64;

/// A message, written once for all browsers.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) kind: &'static str,
    pub(crate) text: Arc<str>,
    /// How many frames are lost with it.
    frames: u64,
}

impl Message {
    pub(crate) fn new(kind: &'static str, value: &impl Serialize, frames: u64) -> Self {
        // Maps with keys that are no strings, and types that refuse, are all that can fail; there are none.
        let text = serde_json::to_string(value).unwrap_or_else(|_| "null".to_owned());
        Self { kind, text: text.into(), frames }
    }
}

#[derive(Default)]
pub(crate) struct Browsers {
    all: Vec<Browser>,
}

struct Browser {
    queue: mpsc::Sender<Message>,
    lost_messages: u64,
    lost_frames: u64,
}

impl Browsers {
    /// Another browser watches; `first` is what it is told first. `None` if there are too many; then nothing is written
    /// for it.
    pub(crate) fn open(&mut self, first: impl FnOnce() -> Vec<Message>) -> Option<mpsc::Receiver<Message>> {
        self.all.retain(|browser| !browser.queue.is_closed());
        if self.all.len() >= MOST_BROWSERS {
            return None;
        }
        let (queue, messages) = mpsc::channel(QUEUE);
        let mut browser = Browser { queue, lost_messages: 0, lost_frames: 0 };
        first().into_iter().for_each(|message| browser.tell(message));
        self.all.push(browser);
        Some(messages)
    }

    /// Tells all that keep up. Waits for none.
    pub(crate) fn tell(&mut self, messages: &[Message], everything: impl Fn() -> Vec<Message>) {
        self.all.retain(|browser| !browser.queue.is_closed());
        for browser in &mut self.all {
            browser.catch_up(&everything);
            messages.iter().for_each(|message| browser.tell(message.clone()));
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.all.iter().filter(|browser| !browser.queue.is_closed()).count()
    }
}

impl Browser {
    fn tell(&mut self, message: Message) {
        let frames = message.frames;
        // Whoever is behind is told nothing until there is room for all that it missed.
        if self.lost_messages > 0 || self.queue.try_send(message).is_err() {
            self.lost_messages += 1;
            self.lost_frames += frames;
        }
    }

    /// A browser that was behind and reads again is told what it missed, and where things stand now.
    fn catch_up(&mut self, everything: impl Fn() -> Vec<Message>) {
        if self.lost_messages == 0 || self.queue.capacity() < QUEUE / 2 {
            return;
        }
        let lost = Lost { messages: self.lost_messages, frames: self.lost_frames };
        (self.lost_messages, self.lost_frames) = (0, 0);
        self.tell(Message::new("lost", &lost, 0));
        everything().into_iter().for_each(|message| self.tell(message));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(number: u64) -> Message {
        Message::new("frames", &number, 10)
    }

    fn told(messages: &mut mpsc::Receiver<Message>) -> Vec<(&'static str, String)> {
        std::iter::from_fn(|| messages.try_recv().ok())
            .map(|message| (message.kind, message.text.to_string()))
            .collect()
    }

    #[test]
    fn a_browser_that_does_not_read_loses_frames_and_is_told_how_many() {
        let mut browsers = Browsers::default();
        let mut slow = browsers.open(|| vec![Message::new("hello", &0, 0)]).unwrap();
        let mut quick = browsers.open(Vec::new).unwrap();
        let everything = || vec![Message::new("state", &7, 0)];
        let mut seen = 0;
        for number in 0..100 {
            browsers.tell(&[frames(number)], everything);
            seen += told(&mut quick).len();
        }
        assert_eq!(seen, 100, "who reads is not held up");
        assert_eq!(told(&mut slow).len(), QUEUE);
        browsers.tell(&[frames(100)], everything);
        let lost = 100 - (QUEUE - 1);
        let expected = [
            ("lost", format!("{{\"messages\":{lost},\"frames\":{}}}", 10 * lost)),
            ("state", "7".to_owned()),
            ("frames", "100".to_owned()),
        ];
        assert_eq!(told(&mut slow), expected);
    }

    #[test]
    fn who_leaves_makes_room() {
        let mut browsers = Browsers::default();
        let mut open: Vec<_> = (0..MOST_BROWSERS).map(|_| browsers.open(Vec::new).unwrap()).collect();
        assert_eq!(browsers.count(), MOST_BROWSERS);
        assert!(browsers.open(|| panic!("nobody writes for who is refused")).is_none());
        open.pop();
        assert!(browsers.open(Vec::new).is_some());
    }
}
