//! Flash and RAM of the images, and how much of it is whose.
//!
//! The share of flash is told by owner: the code is optimised across crates, so that most functions of the middleware
//! have no symbol of their own, but every instruction keeps the chain of functions that it was inlined through. It
//! counts for the innermost one that is not of the library: what the middleware inlines from `core` is its own.
//! The share of RAM is told by type: a variable counts if its type contains one of the middleware's.
//! Constants count for none, since nothing tells their origin.

mod attribution;
mod baseline;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use object::{Object as _, ObjectSection as _, SectionFlags, SectionKind, elf};
use serde::{Deserialize, Serialize};

use crate::images::{self, Images};
use crate::program::{Function, Program};
use crate::run::step;
use crate::workspace::Workspace;
use baseline::Baseline;

/// How to show the sizes.
#[derive(Args)]
pub(crate) struct Options {
    /// Write the sizes as JSON to standard output.
    #[arg(long)]
    json: bool,
    /// Show whose each byte of code is, and the largest functions.
    #[arg(long, conflicts_with = "json")]
    owners: bool,
    /// Fail if an image has outgrown the baseline in firmware/size-baseline.json.
    #[arg(long, conflicts_with = "update")]
    check: bool,
    /// Make the sizes of now the baseline.
    #[arg(long)]
    update: bool,
    /// Look at this ELF file instead of the images; may be given several times.
    #[arg(long = "elf", value_name = "FILE", conflicts_with_all = ["check", "update"])]
    files: Vec<PathBuf>,
}

/// The size of one image, in bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ImageSize {
    /// What is written to flash: code, constants, and the initial values of variables.
    pub(crate) flash: u64,
    /// Variables, without the stack.
    pub(crate) ram: u64,
    /// Code of the middleware, a part of `flash`.
    pub(crate) core_flash: u64,
    /// Variables of the middleware's types, a part of `ram`.
    pub(crate) core_ram: u64,
}

/// The sizes of some images, by name.
pub(crate) type Sizes = BTreeMap<String, ImageSize>;

/// Builds the images and shows their sizes.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<()> {
    let images = images::given_or_built(workspace, &options.files, images::measured)?;
    let sizes = measure_all(&images)?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&sizes)?);
    } else {
        print!("{}", table(&sizes));
    }
    if options.owners {
        for (name, path) in &images {
            let program = Program::read(path)?;
            print!("\n{name}\n{}", owners_table(&attribution::owners(&program)));
            print!("{}", functions_table(&program));
        }
    }
    if options.update {
        Baseline::of(&sizes).write(&baseline_file(workspace))?;
    }
    if options.check { check(workspace, &sizes) } else { Ok(()) }
}

/// Compares sizes with the baseline.
///
/// # Errors
/// What has outgrown it, and by how much.
pub(crate) fn check(workspace: &Workspace, sizes: &Sizes) -> Result<()> {
    step("comparing sizes with the baseline", || {
        let complaints = Baseline::read(&baseline_file(workspace))?.complaints(sizes);
        if !complaints.is_empty() {
            bail!(
                "{}; if that is wanted, `cargo xtask size --update` makes it the baseline",
                complaints.join("; ")
            );
        }
        Ok(())
    })
}

fn baseline_file(workspace: &Workspace) -> PathBuf {
    workspace.root().join("firmware/size-baseline.json")
}

/// Measures some images.
pub(crate) fn measure_all(images: &Images) -> Result<Sizes> {
    images.iter().map(|(name, path)| Ok((name.clone(), measure(path)?))).collect()
}

fn measure(path: &Path) -> Result<ImageSize> {
    let bytes = fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
    measure_elf(&bytes).with_context(|| format!("{} is no image that this can measure", path.display()))
}

fn measure_elf(bytes: &[u8]) -> Result<ImageSize> {
    let file = object::File::parse(bytes)?;
    if file.architecture() != object::Architecture::Arm {
        bail!("it is an ELF file for {:?}, not for Arm", file.architecture());
    }
    let mut size = ImageSize::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        let kept = Kept::of(sh_flags, section.kind() != SectionKind::UninitializedData);
        size.flash += if kept.in_flash { section.size() } else { 0 };
        size.ram += if kept.in_ram { section.size() } else { 0 };
    }
    size.core_flash = attribution::owners(&Program::parse(bytes)?).get("cosmic-core").copied().unwrap_or(0);
    size.core_ram = attribution::variable_bytes(&file, "cosmic_core")?;
    Ok(size)
}

/// Where a section is kept.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Kept {
    in_flash: bool,
    in_ram: bool,
}

impl Kept {
    /// By the flags of the section header: what is allocated has an address, what is writable is
    /// in RAM, and what has contents has them in flash.
    fn of(flags: u64, has_contents: bool) -> Self {
        let allocated = flags & u64::from(elf::SHF_ALLOC) != 0;
        let writable = flags & u64::from(elf::SHF_WRITE) != 0;
        Self { in_flash: allocated && has_contents, in_ram: allocated && writable }
    }
}

/// The sizes as a table for people.
pub(crate) fn table(sizes: &Sizes) -> String {
    let mut text = format!(
        "{:<14} {:>9} {:>12} {:>7} {:>9} {:>12} {:>7}\n",
        "image", "flash B", "of the core", "", "RAM B", "of the core", ""
    );
    for (name, size) in sizes {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:<14} {:>9} {:>12} {:>5} % {:>9} {:>12} {:>5} %",
            name,
            size.flash,
            size.core_flash,
            percent(size.core_flash, size.flash),
            size.ram,
            size.core_ram,
            percent(size.core_ram, size.ram),
        );
    }
    text
}

/// The largest owner first.
fn owners_table(owners: &BTreeMap<String, u64>) -> String {
    let whole = owners.values().sum();
    let mut rows: Vec<_> = owners.iter().collect();
    rows.sort_by_key(|(_, bytes)| std::cmp::Reverse(**bytes));
    let mut text = String::new();
    for (name, &bytes) in rows {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {name:<24} {bytes:>7} {:>5} %", percent(bytes, whole));
    }
    text
}

/// The largest functions, with what was inlined into them.
fn functions_table(program: &Program) -> String {
    let size = |function: &Function| function.end.saturating_sub(function.start);
    let mut functions: Vec<_> = program.functions.iter().collect();
    functions.sort_by_key(|function| std::cmp::Reverse(size(function)));
    let line = |function: &&Function| format!("  {:>7}  {}\n", size(function), function.name);
    functions.iter().take(LARGEST).map(line).collect()
}

/// Functions that are shown.
const LARGEST: usize = 12;

fn percent(part: u64, whole: u64) -> String {
    if whole == 0 {
        return "-".to_owned();
    }
    let permille = (part * 1000 + whole / 2) / whole;
    format!("{}.{}", permille / 10, permille % 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_are_kept_where_their_flags_say() {
        let alloc = u64::from(elf::SHF_ALLOC);
        let writable = alloc | u64::from(elf::SHF_WRITE);
        assert_eq!(Kept::of(alloc, true), Kept { in_flash: true, in_ram: false });
        // Initial values of variables are kept in both.
        assert_eq!(Kept::of(writable, true), Kept { in_flash: true, in_ram: true });
        assert_eq!(Kept::of(writable, false), Kept { in_flash: false, in_ram: true });
        assert_eq!(Kept::of(0, true), Kept { in_flash: false, in_ram: false });
    }

    #[test]
    fn the_largest_functions_come_first() {
        let functions: Vec<_> = (1..=7).map(|halfwords| vec![0_u16; halfwords]).collect();
        let names = ["a", "b", "c", "d", "e", "f", "g"];
        let program = Program::of_parts(&names.into_iter().zip(functions).collect::<Vec<_>>(), &[]);
        let table = functions_table(&program);
        assert_eq!(table.lines().next(), Some("       14  g"));
        assert_eq!(table.lines().last(), Some("        2  a"));
    }

    #[test]
    fn shares_are_rounded() {
        assert_eq!(percent(1, 3), "33.3");
        assert_eq!(percent(2, 3), "66.7");
        assert_eq!(percent(5, 5), "100.0");
        assert_eq!(percent(0, 0), "-");
    }

    #[test]
    fn a_program_of_the_host_is_refused() {
        let own = std::env::current_exe().unwrap();
        let error = format!("{:#}", measure(&own).unwrap_err());
        assert!(error.contains("not for Arm"), "{error}");
        let error = measure(Path::new("/no/such/image")).unwrap_err().to_string();
        assert_eq!(error, "/no/such/image cannot be read");
    }
}
