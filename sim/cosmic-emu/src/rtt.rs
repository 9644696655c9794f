//! Reads RTT up-channels out of the emulated RAM, as a debug probe does.
//!
//! The control block is found by its symbol `_SEGGER_RTT`. It holds an identifier, the numbers of up and
//! down channels, and for each channel name, buffer, size, write and read position, and flags, four bytes
//! each. The host takes what lies between read and write position and moves the read position.

use crate::cpu::{Cpu, NoMemory};

const IDENTIFIER: &[u8] = b"SEGGER RTT";
const HEADER: u32 = 24;
const DESCRIPTOR: u32 = 24;
/// More channels than this are a sign of a control block that is not set up.
const MOST_CHANNELS: u32 = 16;
/// Largest buffer that is believed.
const LARGEST_BUFFER: u32 = 0x2_0000;
const LONGEST_NAME: usize = 64;

/// What a channel held.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Chunk {
    pub(crate) channel: usize,
    pub(crate) bytes: Vec<u8>,
}

/// The reader of one node.
#[derive(Debug)]
pub(crate) struct Rtt {
    control_block: u32,
    /// Empty until the firmware has set up the control block.
    channels: Vec<Channel>,
}

#[derive(Debug)]
struct Channel {
    name: String,
    descriptor: u32,
    buffer: u32,
    size: u32,
}

impl Rtt {
    pub(crate) const fn new(control_block: u32) -> Self {
        Self { control_block, channels: Vec::new() }
    }

    /// The name of a channel that a chunk came from.
    pub(crate) fn name(&self, channel: usize) -> &str {
        self.channels.get(channel).map_or("", |channel| channel.name.as_str())
    }

    /// Takes what is in the channels.
    pub(crate) fn drain(&mut self, cpu: &mut dyn Cpu) -> Result<Vec<Chunk>, NoMemory> {
        if self.channels.is_empty() {
            self.find_channels(cpu)?;
        }
        let mut chunks = Vec::new();
        for (n, channel) in self.channels.iter().enumerate() {
            let bytes = channel.drain(cpu)?;
            if !bytes.is_empty() {
                chunks.push(Chunk { channel: n, bytes });
            }
        }
        Ok(chunks)
    }

    fn find_channels(&mut self, cpu: &dyn Cpu) -> Result<(), NoMemory> {
        let mut identifier = [0; IDENTIFIER.len()];
        cpu.read_memory(self.control_block, &mut identifier)?;
        let count = cpu.read_word(self.control_block + 16)?;
        if identifier != IDENTIFIER || count > MOST_CHANNELS {
            return Ok(());
        }
        for n in 0..count {
            let descriptor = self.control_block + HEADER + n * DESCRIPTOR;
            let word = |offset| cpu.read_word(descriptor + offset);
            let (buffer, size) = (word(4)?, word(8)?);
            let name = read_string(cpu, word(0)?);
            self.channels.push(Channel { name, descriptor, buffer, size: size.min(LARGEST_BUFFER) });
        }
        Ok(())
    }
}

impl Channel {
    fn drain(&self, cpu: &mut dyn Cpu) -> Result<Vec<u8>, NoMemory> {
        let (write, read) = (cpu.read_word(self.descriptor + 12)?, cpu.read_word(self.descriptor + 16)?);
        // Not set up yet, or damaged by the firmware.
        if write == read || write >= self.size || read >= self.size {
            return Ok(Vec::new());
        }
        let mut bytes = Vec::new();
        let mut take = |from: u32, to: u32| {
            let start = bytes.len();
            bytes.resize(start + (to - from) as usize, 0);
            cpu.read_memory(self.buffer + from, &mut bytes[start..])
        };
        if write > read {
            take(read, write)?;
        } else {
            take(read, self.size)?;
            take(0, write)?;
        }
        cpu.write_memory(self.descriptor + 16, &write.to_le_bytes())?;
        Ok(bytes)
    }
}

fn read_string(cpu: &dyn Cpu, address: u32) -> String {
    let mut name = Vec::new();
    let mut byte = [0];
    while name.len() < LONGEST_NAME && cpu.read_memory(address + name.len() as u32, &mut byte).is_ok() {
        if byte[0] == 0 {
            break;
        }
        name.push(byte[0]);
    }
    String::from_utf8_lossy(&name).into_owned()
}
