//! Instructions, registers and bits (data sheet DS20001801, sections 10 to 12).

pub(crate) const WRITE: u8 = 0x02;
pub(crate) const READ: u8 = 0x03;
pub(crate) const BIT_MODIFY: u8 = 0x05;
/// From TXB0SIDH on; two more for each further buffer.
pub(crate) const LOAD_TX: u8 = 0x40;
/// With the bits of the buffers.
pub(crate) const REQUEST_TO_SEND: u8 = 0x80;
/// From RXB0SIDH on; four more for RXB1. Clears the buffer's interrupt flag.
pub(crate) const READ_RX: u8 = 0x90;
pub(crate) const READ_STATUS: u8 = 0xA0;
pub(crate) const RESET: u8 = 0xC0;

pub(crate) const RXF0SIDH: u8 = 0x00;
pub(crate) const CANSTAT: u8 = 0x0E;
pub(crate) const CANCTRL: u8 = 0x0F;
pub(crate) const RXF3SIDH: u8 = 0x10;
pub(crate) const TEC: u8 = 0x1C;
pub(crate) const RXM0SIDH: u8 = 0x20;
pub(crate) const CNF3: u8 = 0x28;
pub(crate) const CANINTE: u8 = 0x2B;
pub(crate) const CANINTF: u8 = 0x2C;
pub(crate) const EFLG: u8 = 0x2D;
/// 0x10 more for each further buffer.
pub(crate) const TXB0CTRL: u8 = 0x30;
pub(crate) const RXB0CTRL: u8 = 0x60;
pub(crate) const RXB1CTRL: u8 = 0x70;

pub(crate) const OPMOD: u8 = 0xE0;
pub(crate) const OPMOD_CONFIGURATION: u8 = 0x80;

pub(crate) const TXREQ: u8 = 1 << 3;

/// Received into both buffers, sent from all three, and a change of EFLG.
pub(crate) const INTERRUPTS: u8 = 0x3F;
pub(crate) const TX0IF: u8 = 1 << 2;
pub(crate) const ERRIF: u8 = 1 << 5;

pub(crate) const RX0OVR: u8 = 1 << 6;
pub(crate) const RX1OVR: u8 = 1 << 7;
pub(crate) const TXBO: u8 = 1 << 5;

/// READ STATUS: a frame is in RXB0, in RXB1.
pub(crate) const STATUS_RX: [u8; 2] = [1 << 0, 1 << 1];
/// READ STATUS: the frame of TXB0, TXB1, TXB2 was sent.
pub(crate) const STATUS_TX: [u8; 3] = [1 << 3, 1 << 5, 1 << 7];

/// SIDL of a filter: extended identifiers only. SIDL of a frame: its identifier is extended.
pub(crate) const EXIDE: u8 = 1 << 3;
pub(crate) const RTR: u8 = 1 << 6;
pub(crate) const DLC: u8 = 0x0F;
