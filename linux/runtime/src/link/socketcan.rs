//! SocketCAN: a CAN controller that the kernel drives.
//!
//! What the kernel has been handed cannot be withdrawn. So it holds at most one frame of each class of this node, and
//! the next is handed over when that one's echo has come back, which the kernel marks by `MSG_CONFIRM` once the frame
//! was sent. What remains is this: an event that becomes more urgent than the one of its class in the kernel waits for
//! it, and most drivers send what they were given in the order in which they got it, so that a soft real-time frame can
//! wait for one non real-time frame of this node, and for the time that this one needs to win the bus. Where that
//! matters, run the publisher on a microcontroller, or let it do without a class.
//!
//! When the controller leaves the bus, or the interface goes down, the kernel drops what it holds; the link then
//! connects anew, and what is still valid is handed over again.

use std::io;
use std::mem;
use std::os::fd::{AsRawFd as _, FromRawFd as _, OwnedFd};

use cosmic_core::can::{ErrorCounters, Frame, Id, Mailbox, Outcome, Payload};
use tokio::io::unix::AsyncFd;

use super::{Link, LinkError, Port};
use crate::descriptor::watched;

/// An interface of the kernel.
#[derive(Clone, Debug)]
pub struct SocketCan {
    interface: String,
}

impl SocketCan {
    /// The interface with this name, such as `can0`.
    pub fn new(interface: impl Into<String>) -> Self {
        Self { interface: interface.into() }
    }
}

impl Link for SocketCan {
    async fn run(&mut self, port: &Port) -> LinkError {
        let failed = |what: String| LinkError::new(format!("SocketCAN on {}: {what}", self.interface));
        let socket = match open(&self.interface) {
            Ok(socket) => socket,
            Err(why) => return failed(why),
        };
        match carry(socket, port).await {
            Ok(()) => failed("ended".to_owned()),
            Err(why) => failed(why),
        }
    }
}

/// Carries frames between a socket and a port.
pub(crate) async fn carry(socket: OwnedFd, port: &Port) -> Result<(), String> {
    let socket = watched(socket).map_err(|error| format!("cannot be waited for: {error}"))?;
    port.connected();
    let mut handed: [Option<Frame>; 3] = [None; 3];
    let mut dropped = 0;
    loop {
        tokio::select! {
            // What the kernel says goes first: an echo makes room.
            biased;
            received = receive(&socket) => {
                let received = received.map_err(|error| format!("the interface is gone: {error}"))?;
                port.lost(received.dropped.wrapping_sub(dropped));
                dropped = received.dropped;
                take(&received, &mut handed, port)?;
            }
            (mailbox, frame) = port.next_frame() => {
                handed[mailbox as usize] = Some(frame);
                send(&socket, &frame).await.map_err(|error| format!("a frame was refused: {error}"))?;
            }
        }
    }
}

/// Takes what the kernel has received.
fn take(received: &Received, handed: &mut [Option<Frame>; 3], port: &Port) -> Result<(), String> {
    match decode(&received.frame) {
        Decoded::Frame(frame) if received.is_own => {
            let place = handed.iter().position(|it| *it == Some(frame));
            if let Some(mailbox) = place.and_then(|at| Mailbox::ALL.get(at).copied()) {
                handed[mailbox as usize] = None;
                port.conclude(mailbox, Outcome::Sent);
            }
        }
        Decoded::Frame(frame) => port.received(&frame),
        Decoded::Foreign => port.foreign(),
        Decoded::Malformed => port.malformed(),
        Decoded::Error { bus_off, errors } => {
            if let Some(errors) = errors {
                port.errors(errors);
            }
            if bus_off {
                port.bus_off();
                return Err(
                    "the controller has left the bus (bus-off): look for a short circuit, a wrong bit rate \
                            or a missing terminator"
                        .to_owned(),
                );
            }
        }
    }
    Ok(())
}

/// What the kernel hands over.
struct Received {
    frame: [u8; CAN_FRAME],
    /// It is the echo of a frame that this socket has sent.
    is_own: bool,
    /// Frames that did not fit in the socket's queue, so far; wraps.
    dropped: u32,
}

enum Decoded {
    Frame(Frame),
    Foreign,
    Malformed,
    Error { bus_off: bool, errors: Option<ErrorCounters> },
}

/// `struct can_frame`: identifier and flags in the order of the machine, length, three bytes, data.
fn decode(bytes: &[u8; CAN_FRAME]) -> Decoded {
    let [a, b, c, d, length, _, _, _, data @ ..] = *bytes;
    let id = u32::from_ne_bytes([a, b, c, d]);
    if id & libc::CAN_ERR_FLAG != 0 {
        let counters = ErrorCounters { transmit: data[6], receive: data[7] };
        let errors = (id & CAN_ERR_CNT != 0).then_some(counters);
        return Decoded::Error { bus_off: id & CAN_ERR_BUSOFF != 0, errors };
    }
    if id & libc::CAN_EFF_FLAG == 0 || id & libc::CAN_RTR_FLAG != 0 {
        return Decoded::Foreign;
    }
    match data.get(..usize::from(length)).and_then(Payload::new) {
        Some(payload) => Decoded::Frame(Frame::new(Id::masked(id), payload)),
        None => Decoded::Malformed,
    }
}

fn encode(frame: &Frame) -> [u8; CAN_FRAME] {
    let mut bytes = [0; CAN_FRAME];
    bytes[..4].copy_from_slice(&(frame.id.raw() | libc::CAN_EFF_FLAG).to_ne_bytes());
    bytes[4] = u8::try_from(frame.payload.len()).unwrap_or(8);
    bytes[8..].copy_from_slice(&frame.payload.padded());
    bytes
}

async fn receive(socket: &AsyncFd<OwnedFd>) -> io::Result<Received> {
    loop {
        let mut ready = socket.readable().await?;
        if let Ok(received) = ready.try_io(|socket| receive_now(socket.get_ref())) {
            return received;
        }
    }
}

/// The queue of the interface may be full for a moment.
async fn send(socket: &AsyncFd<OwnedFd>, frame: &Frame) -> io::Result<()> {
    loop {
        let mut ready = socket.writable().await?;
        match ready.try_io(|socket| Ok(rustix::io::write(socket.get_ref(), &encode(frame))?)) {
            Ok(Err(error)) if error.raw_os_error() == Some(libc::ENOBUFS) => {
                tokio::time::sleep(std::time::Duration::from_millis(1)).await;
            }
            Ok(written) => return written.map(|_| ()),
            Err(_) => {}
        }
    }
}

/// Our own call of `recvmsg`: that of the standard library does not tell the flags.
fn receive_now(socket: &OwnedFd) -> io::Result<Received> {
    let mut frame = [0_u8; CAN_FRAME];
    let mut control = Control([0; 64]);
    let mut part = libc::iovec { iov_base: frame.as_mut_ptr().cast(), iov_len: frame.len() };
    // SAFETY: all zeros are a message header without anything.
    let mut message: libc::msghdr = unsafe { mem::zeroed() };
    message.msg_iov = &raw mut part;
    message.msg_iovlen = 1;
    message.msg_control = control.0.as_mut_ptr().cast();
    message.msg_controllen = control.0.len();
    // SAFETY: the header points to `part` and `control`, which outlive the call and are as long as it says.
    let length = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut message, 0) };
    let length = usize::try_from(length).map_err(|_| io::Error::last_os_error())?;
    if length == 0 {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    if length != CAN_FRAME {
        // No classic frame: it decodes as malformed.
        frame = [0; CAN_FRAME];
        frame[..4].copy_from_slice(&libc::CAN_EFF_FLAG.to_ne_bytes());
        frame[4] = u8::MAX;
    }
    let is_own = message.msg_flags & libc::MSG_CONFIRM != 0 || (cfg!(test) && frame[5] == ECHO_IN_TESTS);
    Ok(Received { frame, is_own, dropped: dropped(&message) })
}

/// Room for control messages, aligned as they must be.
#[repr(align(8))]
struct Control([u8; 64]);

fn dropped(message: &libc::msghdr) -> u32 {
    // SAFETY: the header is as `recvmsg` has left it, and its control messages lie in a buffer that still lives.
    let mut header = unsafe { libc::CMSG_FIRSTHDR(message) };
    while !header.is_null() {
        // SAFETY: not null, so a control message of the buffer.
        let (level, kind) = unsafe { ((*header).cmsg_level, (*header).cmsg_type) };
        if level == libc::SOL_SOCKET && kind == libc::SO_RXQ_OVFL {
            // SAFETY: a control message of this kind carries an u32, which need not be aligned.
            return unsafe { libc::CMSG_DATA(header).cast::<u32>().read_unaligned() };
        }
        // SAFETY: as for the first.
        header = unsafe { libc::CMSG_NXTHDR(message, header) };
    }
    0
}

/// A socket of the interface that also gets its own frames back, and errors.
fn open(interface: &str) -> Result<OwnedFd, String> {
    let flags = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
    // SAFETY: no pointers.
    let socket = unsafe { libc::socket(libc::PF_CAN, flags, libc::CAN_RAW) };
    if socket < 0 {
        let error = io::Error::last_os_error();
        return Err(format!(
            "the kernel has no CAN ({error}): load the module can_raw, or use another kind of link"
        ));
    }
    // SAFETY: it has just been made, and nobody else has it.
    let socket = unsafe { OwnedFd::from_raw_fd(socket) };
    let name = std::ffi::CString::new(interface).map_err(|_| "the name has a zero byte".to_owned())?;
    // SAFETY: a string that ends with zero.
    let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
    if index == 0 {
        return Err("there is no such interface: `ip link` lists them".to_owned());
    }
    let failed = |what: &str| format!("{what}: {}", io::Error::last_os_error());
    let errors = libc::CAN_ERR_MASK;
    set(&socket, libc::SOL_CAN_RAW, libc::CAN_RAW_RECV_OWN_MSGS, 1).map_err(|()| failed("no echo"))?;
    set(&socket, libc::SOL_CAN_RAW, libc::CAN_RAW_ERR_FILTER, errors.cast_signed())
        .map_err(|()| failed("no error frames"))?;
    set(&socket, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1).map_err(|()| failed("no count of losses"))?;
    // SAFETY: all zeros are an address of family 0.
    let mut address: libc::sockaddr_can = unsafe { mem::zeroed() };
    address.can_family = libc::AF_CAN as libc::sa_family_t;
    address.can_ifindex = index.cast_signed();
    let length = mem::size_of::<libc::sockaddr_can>() as libc::socklen_t;
    // SAFETY: the address is as long as is said.
    let bound = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if bound < 0 { Err(failed("cannot be bound: is it up?")) } else { Ok(socket) }
}

fn set(socket: &OwnedFd, level: i32, option: i32, value: i32) -> Result<(), ()> {
    let length = mem::size_of::<i32>() as libc::socklen_t;
    // SAFETY: the value is as long as is said.
    let result =
        unsafe { libc::setsockopt(socket.as_raw_fd(), level, option, (&raw const value).cast(), length) };
    if result < 0 { Err(()) } else { Ok(()) }
}

const CAN_FRAME: usize = 16;
/// linux/can/error.h
const CAN_ERR_BUSOFF: u32 = 0x40;
const CAN_ERR_CNT: u32 = 0x200;
/// A socket pair does not mark echoes; in tests a byte that the kernel leaves alone does.
const ECHO_IN_TESTS: u8 = 0xEC;

#[cfg(test)]
mod tests;
