//! Who calls whom, and how deep the stack gets.
//!
//! Calls by a register are taken to lead to any function whose address is taken somewhere: in a constant, in a
//! table, or by an instruction pair that loads it.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::Range;

use super::Program;
use super::decode::{Instruction, Kind};

/// A function, by its place in the program's list.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) struct FunctionId(pub(crate) usize);

/// A call, or a jump into another function.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Call {
    pub(crate) at: u32,
    pub(crate) from: FunctionId,
    pub(crate) to: FunctionId,
}

type Callees = HashMap<FunctionId, Vec<FunctionId>>;

/// Calls, traps and frames of a program.
#[derive(Debug, Default)]
pub(crate) struct CallGraph {
    pub(crate) calls: Vec<Call>,
    /// Instructions that end the program, but not directly behind a call that does not come back.
    pub(crate) traps: Vec<(u32, FunctionId)>,
    /// Functions whose address is taken.
    pub(crate) taken: BTreeSet<FunctionId>,
    /// Functions that call by a register.
    indirect: HashSet<FunctionId>,
    /// What each function puts on the stack, in bytes.
    frames: HashMap<FunctionId, u32>,
    /// The handlers of the vector table but the first, which starts the program.
    pub(crate) handlers: BTreeSet<FunctionId>,
    /// The one that starts the program.
    pub(crate) reset: Option<FunctionId>,
}

impl CallGraph {
    /// Looks through all code and constants.
    pub(crate) fn of(program: &Program) -> Self {
        let mut graph = Self::default();
        for piece in program.code() {
            graph.scan(program, piece);
        }
        for section in program.sections.iter().filter(|section| !section.is_code) {
            let is_vectors = section.name == ".vector_table";
            for (number, word) in section.bytes.chunks_exact(4).enumerate() {
                let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
                let Some(function) = entry(program, word) else { continue };
                match (is_vectors, number) {
                    (false, _) => {
                        graph.taken.insert(function);
                    }
                    (true, 1) => graph.reset = Some(function),
                    (true, _) => {
                        graph.handlers.insert(function);
                    }
                }
            }
        }
        graph.take_from_pools(program);
        graph
    }

    fn scan(&mut self, program: &Program, piece: Range<u32>) {
        let mut registers = [0_u32; 16];
        let mut called = false;
        let mut at = piece.start;
        while at < piece.end {
            let (first, second) = (program.halfword(at).unwrap_or(0), program.halfword(at + 2).unwrap_or(0));
            let Instruction { kind, len } = Instruction::decode(at, first, second);
            if let Some(from) = program.function_at(at) {
                self.take_in(program, kind, at, from, called, &mut registers);
            }
            called = matches!(kind, Kind::Call(_) | Kind::IndirectCall);
            at += len;
        }
    }

    fn take_in(
        &mut self,
        program: &Program,
        kind: Kind,
        at: u32,
        from: FunctionId,
        called: bool,
        registers: &mut [u32; 16],
    ) {
        match kind {
            Kind::Call(target) | Kind::Jump(target) => {
                if let Some(to) = program.function_at(target).filter(|to| *to != from) {
                    self.calls.push(Call { at, from, to });
                }
            }
            Kind::IndirectCall => {
                self.indirect.insert(from);
            }
            Kind::Trap if !called => self.traps.push((at, from)),
            Kind::Low(register, low) => registers[register as usize & 15] = low.into(),
            Kind::High(register, high) => {
                let value = &mut registers[register as usize & 15];
                *value = *value & 0xFFFF | u32::from(high) << 16;
                self.taken.extend(entry(program, *value));
            }
            Kind::Grow(bytes) => *self.frames.entry(from).or_default() += bytes,
            Kind::GrowBy(register) => {
                *self.frames.entry(from).or_default() += registers[register as usize & 15]
            }
            Kind::Trap | Kind::Other => {}
        }
    }

    /// Constants amidst the code.
    fn take_from_pools(&mut self, program: &Program) {
        let mut from = None;
        for (&at, &is_data) in &program.marks {
            if let Some(start) = from.take() {
                let words = (start..at).step_by(4).take(LONGEST_POOL);
                let word =
                    |at| Some(u32::from(program.halfword(at)?) | u32::from(program.halfword(at + 2)?) << 16);
                self.taken.extend(words.filter_map(word).filter_map(|word| entry(program, word)));
            }
            from = is_data.then_some(at);
        }
    }

    /// All that can be reached from these functions, by whatever way.
    pub(crate) fn reachable(&self, roots: impl IntoIterator<Item = FunctionId>) -> HashSet<FunctionId> {
        let callees = self.callees();
        let mut reached = HashSet::new();
        let mut left: Vec<FunctionId> = roots.into_iter().collect();
        while let Some(function) = left.pop() {
            if !reached.insert(function) {
                continue;
            }
            left.extend(callees.get(&function).into_iter().flatten());
            if self.indirect.contains(&function) {
                left.extend(&self.taken);
            }
        }
        reached
    }

    /// The bytes of stack that a function and all that it calls need, at most. A call by a register counts as one of
    /// the deepest function whose address is taken, once on the way down; a function that calls itself counts once.
    pub(crate) fn stack(&self, root: FunctionId) -> u32 {
        let callees = self.callees();
        let mut known = HashMap::new();
        let mut direct = |&taken| self.depth(taken, &callees, 0, &mut known, &mut Vec::new());
        let behind = self.taken.iter().map(&mut direct).max().unwrap_or(0);
        self.depth(root, &callees, behind, &mut HashMap::new(), &mut Vec::new())
    }

    /// The bytes of stack that the program needs, at most: the start or the idle loop, and on it each handler once, with
    /// what the core saves. Handlers of one priority do not interrupt each other, so it is less in truth.
    pub(crate) fn worst_stack(&self) -> u32 {
        let start = self.reset.map_or(0, |reset| self.stack(reset));
        self.handlers.iter().fold(start, |sum, &handler| sum + self.stack(handler) + SAVED)
    }

    fn callees(&self) -> Callees {
        let mut callees = Callees::new();
        for call in &self.calls {
            callees.entry(call.from).or_default().push(call.to);
        }
        callees
    }

    fn depth(
        &self,
        function: FunctionId,
        callees: &Callees,
        indirect: u32,
        known: &mut HashMap<FunctionId, u32>,
        way: &mut Vec<FunctionId>,
    ) -> u32 {
        if let Some(&depth) = known.get(&function) {
            return depth;
        }
        if way.contains(&function) {
            return 0;
        }
        way.push(function);
        let mut below = if self.indirect.contains(&function) { indirect } else { 0 };
        for &callee in callees.get(&function).into_iter().flatten() {
            below = below.max(self.depth(callee, callees, indirect, known, way));
        }
        way.pop();
        let depth = self.frames.get(&function).copied().unwrap_or(0) + below;
        known.insert(function, depth);
        depth
    }
}

/// The function that a pointer to code leads to.
fn entry(program: &Program, word: u32) -> Option<FunctionId> {
    let at = (word & 1 != 0).then(|| program.function_at(word & !1)).flatten()?;
    (program.functions[at.0].start == word & !1).then_some(at)
}

/// An exception frame with floating point registers, aligned (ARMv7-M ARM, B1.5.7).
const SAVED: u32 = 104 + 4;
/// Words; what follows the last function is no pool.
const LONGEST_POOL: usize = 1024;
