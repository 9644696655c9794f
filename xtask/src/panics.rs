//! Which places of an image can end in a panic, and how deep its stack gets.
//!
//! The image is what counts: a check that the compiler has proven needless is not in it. A place is a call of the
//! panic machinery from code that is not of the machinery, or an instruction that ends the program. What only the
//! start reaches (`Reset`, and with it RTIC's `init`) runs once, before anything depends on the node, and a mistake
//! in the settings may well end there; each such place is in a function of [`AT_START`]. All others are errors.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;

use crate::images::{self, Images};
use crate::program::{CallGraph, Frame, FunctionId, Program};
use crate::run::step;
use crate::workspace::Workspace;

/// Where to look.
#[derive(Args)]
pub(crate) struct Options {
    /// Show the places at the start, too.
    #[arg(long)]
    all: bool,
    /// Look at this ELF file instead of the images; may be given several times.
    #[arg(long = "elf", value_name = "FILE")]
    files: Vec<PathBuf>,
}

/// A place that can end in a panic.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Place {
    /// Who wrote it, innermost first.
    frames: Vec<Frame>,
    /// The function of the image that it is in.
    function: String,
    /// What is called.
    what: String,
}

/// The places of one image.
#[derive(Debug, Default)]
struct Places {
    /// Reached while the node runs.
    running: BTreeSet<Place>,
    /// Reached at the start only, and allowed there.
    at_start: BTreeSet<Place>,
    /// Reached at the start only, by a function that has no business there.
    not_allowed: BTreeSet<Place>,
}

/// Builds the images and shows the places.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<()> {
    let images = images::given_or_built(workspace, &options.files, images::searched)?;
    check(&images, options.all)
}

/// Looks through some images.
///
/// # Errors
/// There is a place that a running node can reach.
pub(crate) fn check(images: &Images, all: bool) -> Result<()> {
    step("looking for places that can panic", || {
        let mut found = 0;
        for (name, path) in images {
            let program = Program::read(path)?;
            let graph = CallGraph::of(&program);
            let places = Places::of(&program, &graph);
            let (stack, room) = (graph.worst_stack(), program.stack.len());
            println!(
                "{name:<14} {} reached while it runs, {} at the start; stack {stack} of {room} bytes at most",
                places.running.len(),
                places.at_start.len() + places.not_allowed.len()
            );
            if stack as usize > room {
                bail!("{name}: the stack may need {stack} bytes, and memory.x gives it {room}");
            }
            show("while it runs", &places.running);
            show("at the start, in no function that is allowed to", &places.not_allowed);
            if all {
                show("at the start", &places.at_start);
            }
            found += places.running.len() + places.not_allowed.len();
        }
        if found > 0 {
            bail!("{found} places can end in a panic");
        }
        Ok(())
    })
}

fn show(when: &str, places: &BTreeSet<Place>) {
    for place in places {
        println!("  {when}: {}, in {}", place.what, place.function);
        for frame in &place.frames {
            println!("      {}:{} {}", short(&frame.file), frame.line, frame.function);
        }
    }
}

/// A path as far as it says something.
fn short(file: &str) -> &str {
    ["/registry/src/", "/library/"]
        .iter()
        .find_map(|mark| file.split_once(mark))
        .map_or(file, |(_, rest)| rest)
}

impl Places {
    fn of(program: &Program, graph: &CallGraph) -> Self {
        let machinery = machinery(program, graph);
        let running = graph.reachable(graph.handlers.iter().chain(&graph.taken).copied());
        let starting = graph.reachable(graph.reset);
        let mut places = Self::default();
        let calls = graph.calls.iter().filter(|call| machinery.contains(&call.to));
        let calls = calls.map(|call| (call.at, call.from, program.functions[call.to.0].name.as_str()));
        let traps = graph.traps.iter().map(|&(at, from)| (at, from, "a trap"));
        for (at, from, what) in calls.chain(traps) {
            let function = &program.functions[from.0];
            if ANYWHERE.iter().any(|(allowed, _)| what.ends_with(allowed)) {
                continue;
            }
            if machinery.contains(&from) || IS_AN_END.contains(&function.name.as_str()) {
                continue;
            }
            let frames = program.frames(at);
            let place = Place { function: function.name.clone(), what: what.to_owned(), frames };
            let is_allowed = || {
                let mut functions = place.frames.iter().map(|frame| frame.function.as_str());
                let inlined = functions.any(|name| AT_START.iter().any(|(allowed, _)| is_of(name, allowed)));
                inlined || AT_START.iter().any(|(allowed, _)| is_of(&place.function, allowed))
            };
            if running.contains(&from) {
                places.running.insert(place);
            } else if starting.contains(&from) {
                let set = if is_allowed() { &mut places.at_start } else { &mut places.not_allowed };
                set.insert(place);
            }
        }
        places
    }
}

/// What belongs to the panic machinery: functions of the library, and of defmt, that come to the panic handler.
fn machinery(program: &Program, graph: &CallGraph) -> HashSet<FunctionId> {
    let mut callers: BTreeMap<FunctionId, Vec<FunctionId>> = BTreeMap::new();
    for call in &graph.calls {
        callers.entry(call.to).or_default().push(call.from);
    }
    let all = (0..program.functions.len()).map(FunctionId);
    let name = |id: FunctionId| program.functions[id.0].name.as_str();
    let mut left: Vec<FunctionId> =
        all.filter(|&id| HANDLERS.iter().any(|handler| name(id).ends_with(handler))).collect();
    let mut machinery = HashSet::new();
    while let Some(function) = left.pop() {
        if machinery.insert(function) {
            let callers = callers.get(&function).into_iter().flatten();
            left.extend(
                callers.filter(|&&caller| LIBRARIES.iter().any(|crate_name| is_of(name(caller), crate_name))),
            );
        }
    }
    machinery
}

/// Returns whether a function is in a crate or module of this path, or has it. Of an implementation counts for whom
/// it is: `<core::cell::RefCell<T>>::borrow` is of `core`.
fn is_of(function: &str, path: &str) -> bool {
    let function = function.trim_start_matches(['<', '&']);
    function
        .strip_prefix(path)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with(':') || rest.starts_with('<'))
        || function.contains(path) && path.contains("::")
}

/// Where a panic ends.
const HANDLERS: [&str; 4] =
    ["rust_begin_unwind", "_defmt_panic", "defmt::export::panic", "panic_cannot_unwind"];

/// Crates whose functions belong to the machinery when they come to it.
const LIBRARIES: [&str; 3] = ["core", "alloc", "defmt"];

/// Functions that end the program on purpose.
const IS_AN_END: [&str; 3] = ["HardFault", "__udf", "DefaultHandler"];

/// Panics that are allowed anywhere, and why.
const ANYWHERE: [(&str, &str); 1] =
    [("panic_const_async_fn_resumed", "the compiler's own: neither `.await` nor RTIC polls what has ended")];

/// Functions in which a panic at the start is allowed, and why.
const AT_START: [(&str, &str); 3] = [
    (
        "stm32f4xx_hal::rcc::f4::pll",
        "it solves for frequencies that are constants of the board: the same at each start",
    ),
    ("::app::init", "a mistake in the settings shows at the first start, with its reason"),
    ("::app::main", "a mistake in the settings shows at the first start, with its reason"),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The start calls `app::init`, which can panic, as can `other`; the handler calls `worker`, which can if `worker`
    /// says so.
    fn program(worker: &[u16]) -> Program {
        // bl to the function `n` of 16 bytes each, from the first instruction of function `from`.
        let call = |from: u32, to: u32| {
            let offset = (i64::from(to) * 16 - (i64::from(from) * 16 + 2 + 4)) as u32;
            [0xF000 | offset >> 12 & 0x3FF | (offset >> 24 & 1) << 10, 0xF800 | offset >> 1 & 0x7FF]
                .map(|half| half as u16)
        };
        let push = 0xB580; // push {r7, lr}
        let calls = |from, to| [[push].as_slice(), &call(from, to), &[0xBD80]].concat();
        let worker = if worker.is_empty() { calls(3, 5) } else { worker.to_vec() };
        let functions = [
            ("Reset", calls(0, 2)),
            ("CAN1_RX0", calls(1, 3)),
            ("sensor::app::init", calls(2, 5)),
            ("cosmic_core::worker", worker),
            ("rust_begin_unwind", vec![0xDEFE]),
            ("core::panicking::panic", calls(5, 4)),
        ];
        Program::of_parts(&functions, &[0x2000_4000, 1, 17])
    }

    fn places(program: &Program) -> Places {
        Places::of(program, &CallGraph::of(program))
    }

    #[test]
    fn a_panic_is_allowed_at_the_start_and_nowhere_else() {
        let found = places(&program(&[]));
        let names =
            |places: &BTreeSet<Place>| places.iter().map(|it| it.function.clone()).collect::<Vec<_>>();
        assert_eq!(names(&found.running), ["cosmic_core::worker"]);
        assert_eq!(names(&found.at_start), ["sensor::app::init"]);
        assert_eq!(names(&found.not_allowed), [""; 0]);
    }

    #[test]
    fn a_function_that_returns_is_no_place_and_a_trap_is() {
        assert!(places(&program(&[0x4770])).running.is_empty());
        let trap = places(&program(&[0xDEFE])).running;
        assert_eq!(trap.iter().map(|it| it.what.as_str()).collect::<Vec<_>>(), ["a trap"]);
    }

    #[test]
    fn the_stack_is_that_of_the_start_and_of_each_handler_on_it() {
        // Reset, init, panic: 8 bytes each. The handler 8, and what it calls none, or 8 and panic's 8.
        let graph = |worker: &[u16]| CallGraph::of(&program(worker)).worst_stack();
        assert_eq!(graph(&[0x4770]), 24 + 8 + 108);
        assert_eq!(graph(&[]), 24 + 24 + 108);
    }
}
