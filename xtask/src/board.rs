//! The boards that images are built for and flashed onto: see docs/boards.md.

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use crate::plan;
use crate::workspace::Workspace;

/// A board.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Board {
    /// Olimex STM32-H405
    Stm32H405,
    /// STM32F4DISCOVERY
    Stm32f4discovery,
    /// NUCLEO-F446RE
    NucleoF446re,
    /// Adafruit Feather STM32F405 Express
    FeatherF405,
}

impl Board {
    /// As probe-rs calls it.
    pub(crate) const fn chip(self) -> &'static str {
        match self {
            Self::Stm32H405 | Self::FeatherF405 => "STM32F405RG",
            Self::Stm32f4discovery => "STM32F407VG",
            Self::NucleoF446re => "STM32F446RE",
        }
    }

    /// The device identifier of the chip: RM0090, 38.6.1; RM0390, 33.6.1.
    pub(crate) const fn device(self) -> u32 {
        match self {
            Self::Stm32H405 | Self::FeatherF405 | Self::Stm32f4discovery => 0x413,
            Self::NucleoF446re => 0x421,
        }
    }

    /// What the build script of the firmware calls it; `None` for those that run what is built for none in particular: with
    /// a crystal of 8 MHz.
    pub(crate) const fn built_as(self) -> Option<&'static str> {
        match self {
            Self::Stm32H405 | Self::Stm32f4discovery => None,
            Self::NucleoF446re => Some("nucleo-f446re"),
            Self::FeatherF405 => Some("feather-f405"),
        }
    }
}

/// The environment variable by which the build script of the firmware learns the board.
pub(crate) const VARIABLE: &str = "COSMIC_BOARD";

/// Where the images for a cluster are kept that are built for a board.
pub(crate) fn folder(workspace: &Workspace, cluster: &Path, board: Option<Board>) -> PathBuf {
    let images = workspace.target_dir().join("images");
    let plan = plan::name(workspace, cluster);
    match board.and_then(Board::built_as) {
        Some(board) => images.join(format!("{plan}-{board}")),
        None => images.join(plan),
    }
}
