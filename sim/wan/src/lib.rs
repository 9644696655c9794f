//! A way between networks that is slow, stalls and breaks: a TCP proxy, for tests and demos where the kernel's own means
//! (`netem`) are not at hand.
//!
//! What TCP makes of a lost packet is a pause, and then all at once; of a cut, either the same after a long time, or a
//! connection that is gone. So a [`Way`] can delay each direction, [stall](State::Stalled), and be [cut](State::Cut).

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// What a way does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum State {
    /// It carries.
    Open,
    /// It keeps what comes, as much as [fits](CHUNKS), and carries it when it is open again.
    Stalled,
    /// Its connections are gone, with what was on them; new ones are refused.
    Cut,
}

/// A direction of a way.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// From who connects to the way.
    There,
    /// To who connects to it.
    Back,
}

/// A way. It ends with its last connection when it is dropped.
pub struct Way {
    address: SocketAddr,
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

struct Shared {
    state: watch::Sender<State>,
    /// In microseconds: there, back.
    delays: [AtomicU64; 2],
    /// Bytes that were carried.
    carried: AtomicU64,
}

impl Drop for Way {
    fn drop(&mut self) {
        self.task.abort();
        self.shared.state.send_replace(State::Cut);
    }
}

impl Way {
    /// A way to an address, from a port of its own on the loopback interface, inside a runtime of tokio.
    ///
    /// # Errors
    /// No port is free.
    pub async fn to(target: SocketAddr) -> std::io::Result<Self> {
        Self::from(Ipv4Addr::LOCALHOST.into(), target).await
    }

    /// As [`to`](Self::to), from a port of this address.
    ///
    /// # Errors
    /// It is no address of this machine, or no port is free.
    pub async fn from(address: IpAddr, target: SocketAddr) -> std::io::Result<Self> {
        let listener = TcpListener::bind((address, 0)).await?;
        let address = listener.local_addr()?;
        let delays = [AtomicU64::new(0), AtomicU64::new(0)];
        let state = watch::Sender::new(State::Open);
        let shared = Arc::new(Shared { state, delays, carried: AtomicU64::new(0) });
        let task = tokio::spawn(accept(listener, target, Arc::clone(&shared)));
        Ok(Self { address, shared, task })
    }

    /// Where to connect to.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Changes what the way does.
    pub fn set(&self, state: State) {
        self.shared.state.send_replace(state);
    }

    /// Delays what enters a direction from now on.
    pub fn delay(&self, direction: Direction, by: Duration) {
        let micros = u64::try_from(by.as_micros()).unwrap_or(u64::MAX);
        self.shared.delays[direction as usize].store(micros, Ordering::Relaxed);
    }

    /// Bytes that were carried so far, in both directions.
    pub fn carried(&self) -> u64 {
        self.shared.carried.load(Ordering::Relaxed)
    }
}

async fn accept(listener: TcpListener, target: SocketAddr, shared: Arc<Shared>) {
    loop {
        let Ok((near, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        if *shared.state.borrow() != State::Cut {
            tokio::spawn(carry(near, target, Arc::clone(&shared)));
        }
    }
}

async fn carry(near: TcpStream, target: SocketAddr, shared: Arc<Shared>) {
    let mut state = shared.state.subscribe();
    let connection = async {
        // Nobody may answer at the other end.
        let Ok(far) = TcpStream::connect(target).await else { return };
        let _ = (near.set_nodelay(true), far.set_nodelay(true));
        let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
        tokio::select! {
            () = pump(from_near, to_far, Direction::There, &shared) => {}
            () = pump(from_far, to_near, Direction::Back, &shared) => {}
        }
    };
    tokio::select! {
        () = connection => {}
        _ = state.wait_for(|state| *state == State::Cut) => {}
    }
}

/// Carries one direction until either end is gone.
async fn pump(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, direction: Direction, shared: &Shared) {
    let (sender, mut receiver) = mpsc::channel::<(Instant, Vec<u8>)>(CHUNKS);
    let read = async {
        loop {
            let mut chunk = vec![0; CHUNK];
            let Ok(len @ 1..) = from.read(&mut chunk).await else { return };
            chunk.truncate(len);
            let delay = Duration::from_micros(shared.delays[direction as usize].load(Ordering::Relaxed));
            if sender.send((Instant::now() + delay, chunk)).await.is_err() {
                return;
            }
        }
    };
    let write = async {
        let mut state = shared.state.subscribe();
        while let Some((due, chunk)) = receiver.recv().await {
            tokio::time::sleep_until(due).await;
            if state.wait_for(|state| *state != State::Stalled).await.is_err() {
                return;
            }
            if to.write_all(&chunk).await.is_err() {
                return;
            }
            shared.carried.fetch_add(chunk.len() as u64, Ordering::Relaxed);
        }
    };
    tokio::select! {
        () = read => {}
        () = write => {}
    }
}

const CHUNK: usize = 4096;
/// Pieces of 4096 bytes that a direction keeps.
pub const CHUNKS: usize = 1024;

#[cfg(test)]
mod tests {
    use super::*;

    async fn echo() -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                tokio::spawn(async move {
                    let (mut from, mut to) = stream.split();
                    let _ = tokio::io::copy(&mut from, &mut to).await;
                });
            }
        });
        address
    }

    async fn round_trip(stream: &mut TcpStream, text: &[u8]) -> Duration {
        let begun = Instant::now();
        stream.write_all(text).await.unwrap();
        let mut back = vec![0; text.len()];
        stream.read_exact(&mut back).await.unwrap();
        assert_eq!(back, text);
        begun.elapsed()
    }

    #[tokio::test]
    async fn each_direction_is_delayed() {
        let way = Way::to(echo().await).await.unwrap();
        let mut stream = TcpStream::connect(way.address()).await.unwrap();
        round_trip(&mut stream, b"warm").await;
        way.delay(Direction::There, Duration::from_millis(70));
        way.delay(Direction::Back, Duration::from_millis(30));
        assert!(round_trip(&mut stream, b"hello").await >= Duration::from_millis(100));
        assert_eq!(way.carried(), 18);
    }

    #[tokio::test]
    async fn a_stall_keeps_and_a_cut_drops() {
        let way = Way::to(echo().await).await.unwrap();
        let mut stream = TcpStream::connect(way.address()).await.unwrap();
        way.set(State::Stalled);
        stream.write_all(b"kept").await.unwrap();
        let mut back = [0; 4];
        let early = tokio::time::timeout(Duration::from_millis(50), stream.read_exact(&mut back)).await;
        assert!(early.is_err());
        way.set(State::Open);
        stream.read_exact(&mut back).await.unwrap();
        assert_eq!(&back, b"kept");
        way.set(State::Cut);
        assert!(matches!(stream.read(&mut back).await, Ok(0) | Err(_)));
        let mut refused = TcpStream::connect(way.address()).await.unwrap();
        assert!(matches!(refused.read(&mut back).await, Ok(0) | Err(_)), "no new ones");
        way.set(State::Open);
        let mut stream = TcpStream::connect(way.address()).await.unwrap();
        round_trip(&mut stream, b"again").await;
    }
}
