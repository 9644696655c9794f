//! Which places of an image can end in a panic.
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
use crate::setup;
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
    let images = if options.files.is_empty() {
        let way = setup::prepare(&[])?;
        images::firmware(workspace, &way, None, &[])?.images
    } else {
        options.files.iter().map(|file| (file.display().to_string(), file.clone())).collect()
    };
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
            let places = Places::of(&Program::read(path)?);
            println!(
                "{name:<14} {} reached while it runs, {} at the start",
                places.running.len(),
                places.at_start.len() + places.not_allowed.len()
            );
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
    fn of(program: &Program) -> Self {
        let graph = CallGraph::of(program);
        let machinery = machinery(program, &graph);
        let running = graph.reachable(graph.handlers.iter().chain(&graph.taken).copied());
        let starting = graph.reachable(graph.reset);
        let mut places = Self::default();
        let calls = graph.calls.iter().filter(|call| machinery.contains(&call.to));
        let calls = calls.map(|call| (call.at, call.from, program.functions[call.to.0].name.as_str()));
        let traps = graph.traps.iter().map(|&(at, from)| (at, from, "a trap"));
        for (at, from, what) in calls.chain(traps) {
            let function = &program.functions[from.0];
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

/// Functions in which a panic at the start is allowed, and why.
const AT_START: [(&str, &str); 2] = [
    ("::app::init", "a mistake in the settings shows at the first start, with its reason"),
    ("::app::main", "a mistake in the settings shows at the first start, with its reason"),
];
