//! Decoded instructions: operations with their operands, independent of their encodings.

use super::common::Common;
use super::operands::{
    Accumulate, Address, Alu, Binary, Extend, Flags, FloatBinary, FloatUnary, Long, Operand, Reg, Shift,
    Unary, Width,
};

/// A decoded instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Op {
    /// Not decoded yet.
    Unknown,
    /// One of the most frequent, in a form of its own.
    Common(Common),
    Undefined,
    Nop,
    /// The first of an endless loop that does nothing, a branch to itself or a NOP before a branch:
    /// instructions and cycles of one turn. It takes one cycle itself.
    Spin {
        instructions: u8,
        cycles: u8,
        is_branch: bool,
    },
    Alu {
        op: Alu,
        rd: Reg,
        rn: Reg,
        operand: Operand,
        flags: Flags,
    },
    /// TST, TEQ, CMN, CMP: only flags.
    Test {
        op: Alu,
        rn: Reg,
        operand: Operand,
    },
    /// ADR, and additions to the word-aligned PC.
    PcRelative {
        rd: Reg,
        offset: i32,
    },
    MoveTop {
        rd: Reg,
        value: u16,
    },
    Extend {
        extend: Extend,
        rd: Reg,
        rn: Reg,
        rm: Reg,
        rotation: u8,
    },
    Unary {
        op: Unary,
        rd: Reg,
        rm: Reg,
    },
    Binary {
        op: Binary,
        rd: Reg,
        rn: Reg,
        rm: Reg,
        flags: Flags,
    },
    Accumulate {
        op: Accumulate,
        rd: Reg,
        rn: Reg,
        rm: Reg,
        ra: Reg,
    },
    Long {
        op: Long,
        low: Reg,
        high: Reg,
        rn: Reg,
        rm: Reg,
    },
    ExtractField {
        rd: Reg,
        rn: Reg,
        lsb: u8,
        width: u8,
        signed: bool,
    },
    /// With R15 as the source, zeros.
    InsertField {
        rd: Reg,
        rn: Reg,
        lsb: u8,
        width: u8,
    },
    Saturate {
        rd: Reg,
        rn: Reg,
        bits: u8,
        shift: Shift,
        amount: u8,
        signed: bool,
    },
    SaturateHalves {
        rd: Reg,
        rn: Reg,
        bits: u8,
        signed: bool,
    },
    Load {
        rt: Reg,
        address: Address,
        width: Width,
    },
    Store {
        rt: Reg,
        address: Address,
        width: Width,
    },
    LoadDual {
        rt: Reg,
        rt2: Reg,
        address: Address,
    },
    StoreDual {
        rt: Reg,
        rt2: Reg,
        address: Address,
    },
    LoadMultiple {
        rn: Reg,
        list: u16,
        write_back: bool,
        decrement: bool,
    },
    StoreMultiple {
        rn: Reg,
        list: u16,
        write_back: bool,
        decrement: bool,
    },
    LoadExclusive {
        rt: Reg,
        rn: Reg,
        offset: u16,
        width: Width,
    },
    StoreExclusive {
        rd: Reg,
        rt: Reg,
        rn: Reg,
        offset: u16,
        width: Width,
    },
    ClearExclusive,
    TableBranch {
        rn: Reg,
        rm: Reg,
        halves: bool,
    },
    Branch {
        offset: i32,
    },
    BranchIf {
        condition: u8,
        offset: i32,
    },
    BranchLink {
        offset: i32,
    },
    BranchExchange {
        rm: Reg,
    },
    BranchLinkExchange {
        rm: Reg,
    },
    CompareBranch {
        rn: Reg,
        offset: i32,
        if_zero: bool,
    },
    IfThen(u8),
    ChangeMasks {
        disable: bool,
        primask: bool,
        faultmask: bool,
    },
    MoveToSpecial {
        rn: Reg,
        special: u8,
        mask: u8,
    },
    MoveFromSpecial {
        rd: Reg,
        special: u8,
    },
    WaitForInterrupt,
    WaitForEvent,
    SendEvent,
    SupervisorCall,
    Breakpoint(u8),
    FloatBinary {
        op: FloatBinary,
        sd: u8,
        sn: u8,
        sm: u8,
    },
    FloatUnary {
        op: FloatUnary,
        sd: u8,
        sm: u8,
    },
    FloatConstant {
        sd: u8,
        bits: u32,
    },
    /// With zero, if there is no second register.
    FloatCompare {
        sd: u8,
        sm: Option<u8>,
    },
    /// Between fixed and floating point; `fraction` bits behind the point.
    FloatFixed {
        sd: u8,
        to_fixed: bool,
        fraction: u8,
        halves: bool,
        signed: bool,
    },
    FloatLoad {
        first: u8,
        count: u8,
        address: Address,
    },
    FloatStore {
        first: u8,
        count: u8,
        address: Address,
    },
    FloatMultiple {
        rn: Reg,
        first: u8,
        count: u8,
        write_back: bool,
        decrement: bool,
        load: bool,
    },
    /// One word between a core and a floating point register.
    FloatMove {
        rt: Reg,
        sn: u8,
        to_core: bool,
    },
    FloatMovePair {
        rt: Reg,
        rt2: Reg,
        first: u8,
        to_core: bool,
    },
    /// With R15, the flags go to APSR.
    FloatStatus {
        rt: Reg,
        to_core: bool,
    },
}
