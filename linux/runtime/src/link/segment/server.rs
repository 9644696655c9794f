//! The server of a segment.

use std::collections::HashMap;
use std::convert::Infallible;
use std::path::Path;

use cosmic_bus::{EventKind, VirtualInstant};
use cosmic_core::can::Mailbox;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::bus::{Member, MemberEvent, Segment, is_bus_off};
use super::record::{Record, VERSION};
use super::socket::{ServeError, Socket};
use super::time::Alarm;

/// How a segment is served.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Options {
    /// Time passes as tokio's clock does, which tests can stop. Otherwise as that of the kernel, which is finer.
    pub tokio_time: bool,
}

/// What a connection wants. The number of the member is used again, that of the connection is not.
struct Wish {
    member: Member,
    connection: u64,
    /// `None`: it has ended, or talks nonsense.
    record: Option<Record>,
}

struct Client {
    connection: u64,
    tasks: [JoinHandle<()>; 2],
    to: mpsc::Sender<Record>,
    lost: u32,
    errors: (u8, u8),
}

struct Server<S> {
    segment: S,
    start: Instant,
    clients: HashMap<Member, Client>,
    connections: u64,
    wishes: mpsc::Sender<Wish>,
    events: Vec<MemberEvent>,
}

/// Serves a segment at a socket there, for ever: [`Socket::bind`] and [`Socket::serve`].
///
/// # Errors
/// [`ServeError`]: somebody else serves there, or the socket cannot be made.
pub async fn serve(
    path: impl AsRef<Path>,
    segment: impl Segment,
    options: Options,
) -> Result<Infallible, ServeError> {
    Socket::bind(path.as_ref()).await?.serve(segment, options).await
}

impl Socket {
    /// Serves a segment, for ever.
    ///
    /// # Errors
    /// There is no timer.
    pub async fn serve(self, segment: impl Segment, options: Options) -> Result<Infallible, ServeError> {
        let alarm =
            Alarm::new(options.tokio_time).map_err(|error| self.failed(format!("no timer: {error}")))?;
        let (wishes, mut wished) = mpsc::channel(WISHES);
        let (clients, events) = (HashMap::new(), Vec::new());
        let mut server = Server { segment, start: Instant::now(), clients, connections: 0, wishes, events };
        loop {
            server.advance();
            let next = server.segment.next_event().map(|at| server.instant(at));
            tokio::select! {
                biased;
                Some(wish) = wished.recv() => server.grant(wish),
                accepted = self.listener.accept() => match accepted {
                    Ok((stream, _)) => server.accept(stream),
                    // Too many files are open, for example: later there may be fewer.
                    Err(_) => tokio::time::sleep(std::time::Duration::from_millis(100)).await,
                },
                () = alarm.wait_until(next) => {}
            }
        }
    }
}

impl<S: Segment> Server<S> {
    fn now(&self) -> VirtualInstant {
        VirtualInstant::from_ticks(u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX / 2))
    }

    fn instant(&self, at: VirtualInstant) -> Instant {
        self.start + std::time::Duration::from_nanos(at.as_ticks())
    }

    fn accept(&mut self, stream: UnixStream) {
        let now = self.now();
        let Some(member) = self.segment.attach(now) else { return };
        let (from, to) = stream.into_split();
        let (sender, receiver) = mpsc::channel(RECORDS);
        let bits_per_second = self.segment.bit_rate().bits_per_second();
        // The queue is empty.
        let _ = sender.try_send(Record::Hello { version: VERSION, bits_per_second });
        self.connections += 1;
        let connection = self.connections;
        let tasks = [
            tokio::spawn(write(to, receiver)),
            tokio::spawn(read(from, member, connection, self.wishes.clone())),
        ];
        self.clients.insert(member, Client { connection, tasks, to: sender, lost: 0, errors: (0, 0) });
    }

    fn grant(&mut self, wish: Wish) {
        let (now, member) = (self.now(), wish.member);
        if self.clients.get(&member).is_none_or(|client| client.connection != wish.connection) {
            return;
        }
        let follows_the_rules = match wish.record {
            Some(Record::Load { mailbox, frame }) => self.segment.load(now, member, mailbox as usize, frame),
            Some(Record::Withdraw { mailbox }) => {
                self.segment.withdraw(now, member, mailbox as usize);
                true
            }
            _ => false,
        };
        if !follows_the_rules {
            self.dismiss(member, now);
        }
    }

    fn dismiss(&mut self, member: Member, now: VirtualInstant) {
        if self.clients.remove(&member).is_some() {
            self.segment.detach(now, member);
        }
    }

    fn advance(&mut self) {
        let now = self.now();
        let mut events = std::mem::take(&mut self.events);
        self.segment.advance(now, &mut events);
        for event in events.drain(..) {
            let Some(client) = self.clients.get_mut(&event.member) else { continue };
            match event.kind {
                EventKind::Received(frame) => client.tell(Record::Received { frame, at: event.at }),
                EventKind::Sent { mailbox } => client.conclude(mailbox, |mailbox| Record::Sent { mailbox }),
                EventKind::Withdrawn { mailbox } => {
                    client.conclude(mailbox, |mailbox| Record::Withdrawn { mailbox });
                }
                kind if is_bus_off(&kind) => client.tell(Record::BusOff),
                EventKind::Failed { .. } | EventKind::ErrorState(_) => {}
            }
            let errors = self.segment.errors(event.member);
            if std::mem::replace(&mut client.errors, errors) != errors {
                client.tell(Record::Errors { transmit: errors.0, receive: errors.1 });
            }
        }
        self.events = events;
        let hung: Vec<_> = self.clients.iter().filter(|it| it.1.lost >= TOO_MANY).map(|it| *it.0).collect();
        hung.into_iter().for_each(|member| self.dismiss(member, now));
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

impl Client {
    /// Counts what does not fit, and says so as soon as something does.
    fn tell(&mut self, record: Record) {
        if self.lost > 0 {
            match self.to.try_send(Record::Lost { count: self.lost }) {
                Ok(()) => self.lost = 0,
                Err(_) => {
                    self.lost += 1;
                    return;
                }
            }
        }
        if self.to.try_send(record).is_err() {
            self.lost += 1;
        }
    }

    /// An outcome must not be lost, for the client would wait for it for good: one that cannot be told ends the
    /// connection.
    fn conclude(&mut self, mailbox: usize, record: impl Fn(Mailbox) -> Record) {
        let Some(&mailbox) = Mailbox::ALL.get(mailbox) else { return };
        self.tell(record(mailbox));
        if self.lost > 0 {
            self.lost = TOO_MANY;
        }
    }
}

async fn read(mut from: OwnedReadHalf, member: Member, connection: u64, wishes: mpsc::Sender<Wish>) {
    let mut bytes = [0; Record::LEN];
    loop {
        let record = match from.read_exact(&mut bytes).await {
            Ok(_) => Record::decode(&bytes),
            Err(_) => None,
        };
        let ends = record.is_none();
        if wishes.send(Wish { member, connection, record }).await.is_err() || ends {
            return;
        }
    }
}

async fn write(mut to: OwnedWriteHalf, mut records: mpsc::Receiver<Record>) {
    while let Some(record) = records.recv().await {
        if to.write_all(&record.encode()).await.is_err() {
            return;
        }
    }
}

/// Records that wait for a client.
const RECORDS: usize = 1024;
/// Wishes of all clients that wait.
const WISHES: usize = 256;
/// A client that has lost so many is dismissed.
const TOO_MANY: u32 = 100_000;
