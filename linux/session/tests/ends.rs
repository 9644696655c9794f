//! A session ends when it is closed, whoever still has a part of it; and a session that cannot begin ends, too.

use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use cosmic_core::Subject;
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::Importance;
use cosmic_linux::link::segment::{Record, VERSION};
use cosmic_session::{Class, Failure, Quality, Queue, Session, Settings, Times};
use std::io::{Read as _, Write as _};

/// Only a call that hangs takes so long.
const PATIENCE: Duration = Duration::from_secs(60);

fn settings(link: &str, tx_node: u8) -> Settings {
    let mut settings = Settings::new(link.parse().unwrap());
    settings.tx_node = TxNode::new(tx_node);
    settings
}

fn subject() -> Subject {
    Subject::new(0x2A).unwrap()
}

/// Etag 5000.
fn quality() -> Quality {
    let class = Class::NonRealTime { importance: Importance::LEAST, validity: None };
    Quality { class, etag: cosmic_core::can::Etag::new(5000) }
}

/// What a call returns, in another thread; a call that hangs fails the test.
fn in_time<T: Send + 'static>(call: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || sender.send(call()));
    receiver.recv_timeout(PATIENCE).expect("the call returns")
}

/// A segment that greets who connects, and then waits until they are gone.
fn segment(path: &Path) -> thread::JoinHandle<()> {
    let listener = UnixListener::bind(path).unwrap();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&Record::Hello { version: VERSION, bits_per_second: 1_000_000 }.encode()).unwrap();
        while stream.read(&mut [0; 256]).is_ok_and(|read| read > 0) {}
    })
}

#[test]
fn a_session_that_is_closed_leaves_the_segment_though_a_subscription_lives() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    let served = segment(&path);
    let session = Session::open(&settings(&format!("sim:{}", path.display()), 7)).unwrap();
    let subscription = session.subscribe(subject(), Some(&quality()), Queue::Latest).unwrap();
    session.close();
    in_time(move || served.join().unwrap());
    assert!(session.is_closed());
    assert_eq!(subscription.next(None), Err(cosmic_session::Closed));
    let refused = session.subscribe(subject(), Some(&quality()), Queue::Latest);
    assert_eq!(refused.err(), Some(Failure::Closed));
    assert_eq!(session.announce(subject(), Some(&quality())), Err(Failure::Closed));
    assert_eq!(session.publish(subject(), &[1], Times::of_channel()), Err(Failure::Closed));
}

/// No broker gives this one its TxNode.
#[test]
fn who_waits_in_a_call_is_told_that_the_session_is_closed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    let _served = segment(&path);
    let mut settings = Settings::new(format!("sim:{}", path.display()).parse().unwrap());
    settings.patience = 100 * PATIENCE;
    let session = std::sync::Arc::new(Session::open(&settings).unwrap());
    let waiting = std::sync::Arc::clone(&session);
    let waits = thread::spawn(move || waiting.subscribe(subject(), None, Queue::Latest).err());
    // It closes before, while, or after the other waits.
    thread::sleep(Duration::from_millis(50));
    session.close();
    assert_eq!(in_time(move || waits.join().unwrap()), Some(Failure::Closed));
}

/// Nobody writes into the pipe, so that opening it takes for ever.
#[test]
fn a_session_that_cannot_be_opened_says_so_though_its_thread_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut settings = settings(&format!("log:{}", pipe.display()), 7);
    settings.patience = Duration::from_millis(20);
    let failure = in_time(move || Session::open(&settings).err());
    assert!(matches!(failure, Some(Failure::Link(_))), "{failure:?}");
}
