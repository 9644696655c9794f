//! The control block of RTT, in which a debug probe finds the channels, and their rings of bytes.
//!
//! The layout is SEGGER's: an identifier of 16 bytes, the numbers of up and down channels, and for each channel
//! name, buffer, size, write and read position, and flags. The probe looks for the identifier in RAM, so that it is
//! written last, and stands nowhere in flash.
//!
//! What is written becomes visible to the probe when it is whole: until then the write position stays.

use core::ffi::CStr;
use core::sync::atomic::{AtomicBool, AtomicPtr, AtomicU8, AtomicU32, Ordering};

/// The number of the log's channel.
pub(crate) const LOG: usize = 0;
/// The number of the other one.
pub(crate) const DATA: usize = 1;
const CHANNELS: usize = 2;

/// The control block, as the probe reads it.
#[repr(C)]
pub(crate) struct Control {
    identifier: [AtomicU8; IDENTIFIER.len()],
    up_channels: AtomicU32,
    down_channels: AtomicU32,
    up: [Descriptor; CHANNELS],
    // Behind what the probe reads.
    taken: [AtomicBool; CHANNELS],
}

#[repr(C)]
struct Descriptor {
    name: AtomicPtr<u8>,
    buffer: AtomicPtr<u8>,
    size: AtomicU32,
    /// Written here.
    write: AtomicU32,
    /// Written by the probe.
    read: AtomicU32,
    /// 0: nobody waits for the probe.
    flags: AtomicU32,
}

/// The block of this program. All zero, so that it takes no flash.
#[cfg(target_arch = "arm")]
#[unsafe(export_name = "_SEGGER_RTT")]
pub(crate) static CONTROL: Control = Control::new();

impl Control {
    pub(crate) const fn new() -> Self {
        Self {
            identifier: [const { AtomicU8::new(0) }; _],
            up_channels: AtomicU32::new(0),
            down_channels: AtomicU32::new(0),
            up: [const { Descriptor::new() }; _],
            taken: [const { AtomicBool::new(false) }; _],
        }
    }

    /// Sets up a channel, once, and before the block is [published](Self::publish).
    pub(crate) fn channel(
        &'static self,
        number: usize,
        name: &'static CStr,
        buffer: &'static mut [u8],
    ) -> Option<Channel> {
        let (descriptor, taken) = (self.up.get(number)?, self.taken.get(number)?);
        let is_published = self.up_channels.load(Ordering::Relaxed) > 0;
        if is_published || taken.swap(true, Ordering::Relaxed) {
            return None;
        }
        descriptor.name.store(name.as_ptr().cast_mut().cast(), Ordering::Relaxed);
        descriptor.size.store(buffer.len() as u32, Ordering::Relaxed);
        descriptor.buffer.store(buffer.as_mut_ptr(), Ordering::Relaxed);
        Some(Channel { descriptor, size: buffer.len() as u32 })
    }

    /// Lets the probe find the block. It reads the channels once, so that all are set up by now.
    pub(crate) fn publish(&self) {
        self.up_channels.store(CHANNELS as u32, Ordering::Relaxed);
        for (slot, byte) in self.identifier.iter().zip(IDENTIFIER) {
            slot.store(!byte, Ordering::Release);
        }
    }
}

impl Descriptor {
    const fn new() -> Self {
        Self {
            name: AtomicPtr::new(core::ptr::null_mut()),
            buffer: AtomicPtr::new(core::ptr::null_mut()),
            size: AtomicU32::new(0),
            write: AtomicU32::new(0),
            read: AtomicU32::new(0),
            flags: AtomicU32::new(0),
        }
    }
}

/// An up-channel, for its one writer.
pub struct Channel {
    descriptor: &'static Descriptor,
    size: u32,
}

/// What has been put into a ring, and is not visible yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Staged {
    at: u32,
    room: u32,
    fits: bool,
}

impl Staged {
    pub(crate) const NOTHING: Self = Self { at: 0, room: 0, fits: false };
}

impl Channel {
    /// Writes all of it, or nothing if there is no room. Returns whether it was written.
    pub fn write(&mut self, bytes: &[u8]) -> bool {
        let mut staged = self.begin();
        self.put(&mut staged, bytes);
        self.commit(staged)
    }

    /// Begins to write something.
    pub(crate) fn begin(&self) -> Staged {
        let at = self.descriptor.write.load(Ordering::Relaxed);
        let read = self.descriptor.read.load(Ordering::Acquire);
        // One byte stays free: full and empty would look the same. A probe that writes nonsense finds no room.
        let ahead = if read > at { read - at } else { read + (self.size - at) };
        Staged { at, room: if read < self.size { ahead - 1 } else { 0 }, fits: true }
    }

    /// Goes on with it.
    pub(crate) fn put(&self, staged: &mut Staged, bytes: &[u8]) {
        let len = bytes.len() as u32;
        if !staged.fits || len > staged.room {
            staged.fits = false;
            return;
        }
        let buffer = self.descriptor.buffer.load(Ordering::Relaxed);
        for byte in bytes {
            // SAFETY: `buffer` has `size` bytes, given up for this ring. `at` is below `size`: it starts as a
            // position that was written here, or 0, and is brought back to 0 at the end. The probe reads only
            // behind the write position.
            unsafe { buffer.add(staged.at as usize).write_volatile(*byte) };
            staged.at = if staged.at + 1 == self.size { 0 } else { staged.at + 1 };
        }
        staged.room -= len;
    }

    /// Makes it visible, if there was room for all. Returns whether there was.
    pub(crate) fn commit(&self, staged: Staged) -> bool {
        if staged.fits {
            self.descriptor.write.store(staged.at, Ordering::Release);
        }
        staged.fits
    }
}

/// `SEGGER RTT`, each byte inverted: the probe must not find it in flash.
const IDENTIFIER: [u8; 16] = {
    let name = *b"SEGGER RTT\0\0\0\0\0\0";
    let mut inverted = [0; 16];
    let mut at = 0;
    while at < name.len() {
        inverted[at] = !name[at];
        at += 1;
    }
    inverted
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;
    use std::vec::Vec;

    fn channel(size: usize) -> (&'static Control, Channel) {
        let control: &'static Control = Box::leak(Box::new(Control::new()));
        let buffer = Box::leak(std::vec![0; size].into_boxed_slice());
        let channel = control.channel(LOG, c"log", buffer).unwrap();
        (control, channel)
    }

    /// What a probe does.
    fn read(control: &Control) -> Vec<u8> {
        let up = &control.up[LOG];
        let (size, write) = (up.size.load(Ordering::Relaxed), up.write.load(Ordering::Relaxed));
        let mut bytes = Vec::new();
        let mut at = up.read.load(Ordering::Relaxed);
        while at != write {
            // SAFETY: the position is below the size of the buffer, which lives for ever.
            bytes.push(unsafe { *up.buffer.load(Ordering::Relaxed).add(at as usize) });
            at = (at + 1) % size;
        }
        up.read.store(at, Ordering::Relaxed);
        bytes
    }

    #[test]
    fn a_probe_finds_the_block_as_segger_lays_it_out() {
        let (control, _) = channel(8);
        assert!(control.identifier.iter().all(|byte| byte.load(Ordering::Relaxed) == 0));
        control.publish();
        let words = core::ptr::from_ref(control).cast::<u8>();
        // SAFETY: the block has these bytes.
        let head = unsafe { core::slice::from_raw_parts(words, 24) };
        assert_eq!(head, b"SEGGER RTT\0\0\0\0\0\0\x02\0\0\0\0\0\0\0");
        assert_eq!(core::mem::offset_of!(Control, up), 24);
    }

    #[test]
    fn a_channel_is_set_up_once_and_before_a_probe_may_look() {
        let (control, _) = channel(8);
        let buffer = || -> &'static mut [u8] { Box::leak(Box::new([0; 4])) };
        assert!(control.channel(LOG, c"again", buffer()).is_none());
        control.publish();
        assert!(control.channel(DATA, c"late", buffer()).is_none());
    }

    #[test]
    fn what_finds_no_room_is_left_out_whole() {
        let (control, mut channel) = channel(8);
        assert!(channel.write(b"12345"));
        assert!(!channel.write(b"678"));
        assert!(channel.write(b"67"));
        assert!(!channel.write(b"8"));
        assert_eq!(read(control), b"1234567");
        assert!(channel.write(b"abcdefg"));
        assert_eq!(read(control), b"abcdefg");
    }

    #[test]
    fn nothing_is_visible_before_it_is_whole() {
        let (control, channel) = channel(8);
        let mut staged = channel.begin();
        channel.put(&mut staged, b"12");
        assert_eq!(read(control), b"");
        channel.put(&mut staged, b"3");
        assert!(channel.commit(staged));
        assert_eq!(read(control), b"123");
        let mut too_long = channel.begin();
        channel.put(&mut too_long, b"123456");
        channel.put(&mut too_long, b"78");
        channel.put(&mut too_long, b"");
        assert!(!channel.commit(too_long));
        assert_eq!(read(control), b"");
    }

    #[test]
    fn a_ring_without_room_and_a_probe_that_writes_nonsense_take_nothing() {
        let (_, mut none) = channel(0);
        assert!(!none.write(b"1"));
        let (_, mut one) = channel(1);
        assert!(!one.write(b"1"));
        let (control, mut wild) = channel(8);
        control.up[LOG].read.store(77, Ordering::Relaxed);
        assert!(!wild.write(b"1"));
    }
}
