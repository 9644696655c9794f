//! The firmware: an ELF file as it is flashed, with its symbols.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use defmt_decoder::Table;
use object::elf::{self, PT_LOAD};
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol, SymbolKind};

use crate::memory;

/// Why a firmware file cannot be run. Each message names the file and what to do.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("{}: cannot be read ({error}); build the firmware first, or correct the path", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the operating system says.
        error: std::io::Error,
    },
    /// It is no ELF file, or a broken one.
    #[error("{}: not an ELF file ({error}); give the file that is flashed, not a .bin or .hex", file.display())]
    NotElf {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        error: object::Error,
    },
    /// It is for another processor.
    #[error("{}: for another machine, not for a 32-bit little-endian Arm; build for thumbv7em-none-eabihf",
            file.display())]
    OtherMachine {
        /// The file.
        file: PathBuf,
    },
    /// There is no vector table where the core looks for it.
    #[error("{}: no vector table at {:#010x} ({reason}); link with cortex-m-rt's link.x and a memory.x whose \
             FLASH starts there", file.display(), memory::FLASH.base)]
    NoVectorTable {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: &'static str,
    },
    /// A part of it lies outside of the memories of the STM32F405.
    #[error("{}: segment {address:#010x} + {size:#x} lies outside of flash memory and RAM; correct memory.x \
             (FLASH {:#010x} + {:#x}, RAM {:#010x} + {:#x})", file.display(), memory::FLASH.base,
            memory::FLASH.size, memory::RAM.base, memory::RAM.size)]
    OutsideMemory {
        /// The file.
        file: PathBuf,
        /// Where the segment starts.
        address: u32,
        /// How long it is.
        size: u64,
    },
    /// Its defmt data cannot be used.
    #[error("{}: its defmt data cannot be used ({reason}); build firmware and emulator from one Cargo.lock",
            file.display())]
    Defmt {
        /// The file.
        file: PathBuf,
        /// What the decoder says.
        reason: String,
    },
}

/// A firmware that was loaded.
pub(crate) struct Image {
    pub(crate) file: PathBuf,
    /// The content of the flash memory, from its start on.
    pub(crate) flash: Vec<u8>,
    /// What else is loaded, in RAM.
    pub(crate) ram: Vec<(u32, Vec<u8>)>,
    /// Functions by address: size and name.
    functions: BTreeMap<u32, (u32, String)>,
    /// The RTT control block.
    pub(crate) rtt: Option<u32>,
    /// The formats of its logs.
    pub(crate) defmt: Option<Table>,
}

impl Image {
    /// Reads the file.
    pub(crate) fn read(file: &Path) -> Result<Self, LoadError> {
        let bytes =
            std::fs::read(file).map_err(|error| LoadError::Unreadable { file: file.to_owned(), error })?;
        Self::parse(file, &bytes)
    }

    /// Takes the bytes of an ELF file; `file` is for messages.
    pub(crate) fn parse(file: &Path, bytes: &[u8]) -> Result<Self, LoadError> {
        let owned = || file.to_owned();
        let not_elf = |error| LoadError::NotElf { file: owned(), error };
        match object::FileKind::parse(bytes).map_err(not_elf)? {
            object::FileKind::Elf32 => {}
            _ => return Err(LoadError::OtherMachine { file: owned() }),
        }
        let object: ElfFile32<'_, Endianness> = ElfFile32::parse(bytes).map_err(not_elf)?;
        if object.architecture() != object::Architecture::Arm || !object.is_little_endian() {
            return Err(LoadError::OtherMachine { file: owned() });
        }
        let mut image = Self {
            file: owned(),
            flash: Vec::new(),
            ram: Vec::new(),
            functions: functions(&object),
            rtt: object.symbol_by_name("_SEGGER_RTT").map(|symbol| symbol.address() as u32),
            defmt: None,
        };
        for segment in object.elf_program_headers() {
            image.load(&object, segment)?;
        }
        image.check_vectors()?;
        image.defmt = Table::parse(bytes)
            .map_err(|error| LoadError::Defmt { file: owned(), reason: format!("{error:#}") })?;
        Ok(image)
    }

    /// Loads a segment where the programmer puts it: at its physical address.
    fn load(
        &mut self,
        object: &ElfFile32<'_, Endianness>,
        segment: &elf::ProgramHeader32<Endianness>,
    ) -> Result<(), LoadError> {
        let endian = object.endian();
        if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
            return Ok(());
        }
        let address = segment.p_paddr(endian);
        let outside = || LoadError::OutsideMemory {
            file: self.file.clone(),
            address,
            size: segment.p_filesz(endian).into(),
        };
        let data = segment.data(endian, object.data()).map_err(|()| outside())?;
        if memory::FLASH.holds(address, data.len()) {
            let start = (address - memory::FLASH.base) as usize;
            let end = start + data.len();
            if self.flash.len() < end {
                self.flash.resize(end, 0xFF);
            }
            self.flash[start..end].copy_from_slice(data);
        } else if memory::RAM.holds(address, data.len()) || memory::CCM.holds(address, data.len()) {
            self.ram.push((address, data.to_vec()));
        } else {
            return Err(outside());
        }
        Ok(())
    }

    fn check_vectors(&self) -> Result<(), LoadError> {
        let bad = |reason| Err(LoadError::NoVectorTable { file: self.file.clone(), reason });
        let word = |at: usize| {
            let bytes = self.flash.get(at..at + 4)?;
            Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        let (Some(stack), Some(reset)) = (word(0), word(4)) else {
            return bad("nothing is loaded there");
        };
        // The stack grows down, so it starts behind the end of a memory at most.
        let is_ram = |at: u32| memory::RAM.holds(at, 0) || memory::CCM.holds(at, 0);
        if !is_ram(stack) {
            return bad("the initial stack pointer is not in RAM");
        }
        if reset & 1 == 0 || !memory::FLASH.holds(reset & !1, 2) {
            return bad("the reset vector is no Thumb address in flash memory");
        }
        Ok(())
    }

    /// The function that an address lies in, with the offset, for people.
    pub(crate) fn symbol(&self, address: u32) -> Option<String> {
        let (start, (size, name)) = self.functions.range(..=address & !1).next_back()?;
        let offset = (address & !1) - start;
        // Assembly functions have no size.
        if offset >= *size && *size != 0 {
            return None;
        }
        Some(if offset == 0 { name.clone() } else { format!("{name} + {offset:#x}") })
    }

    /// The address of a function by its full name, or by the end of its path.
    pub(crate) fn function(&self, name: &str) -> Option<u32> {
        let suffix = format!("::{name}");
        let exact = self.functions.iter().find(|(_, (_, candidate))| candidate == name);
        let by_path = || self.functions.iter().find(|(_, (_, candidate))| candidate.ends_with(&suffix));
        exact.or_else(by_path).map(|(address, _)| *address)
    }
}

fn functions(object: &ElfFile32<'_, Endianness>) -> BTreeMap<u32, (u32, String)> {
    let functions = object.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text);
    functions
        .filter_map(|symbol| {
            let name = symbol.name().ok().filter(|name| !name.is_empty() && !name.starts_with('$'))?;
            let name = format!("{:#}", rustc_demangle::demangle(name));
            Some((symbol.address() as u32 & !1, (symbol.size() as u32, name)))
        })
        .collect()
}
