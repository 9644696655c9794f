//! The sizes that were accepted last.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};

use super::Sizes;

/// Accepted sizes, and how much more is let pass.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Baseline {
    /// By how many percent an image may grow.
    tolerance_percent: u64,
    /// The accepted sizes, in bytes.
    images: Sizes,
}

impl Baseline {
    /// A baseline of these sizes.
    pub(super) fn of(sizes: &Sizes) -> Self {
        Self { tolerance_percent: TOLERANCE_PERCENT, images: sizes.clone() }
    }

    /// Reads it.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).with_context(|| {
            format!("{} cannot be read; `cargo xtask size --update` writes it", path.display())
        })?;
        serde_json::from_str(&text).with_context(|| {
            format!("{} is no baseline; `cargo xtask size --update` writes it anew", path.display())
        })
    }

    /// Writes it.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
    }

    /// One sentence for everything that has outgrown the baseline, is not in it, or is gone.
    pub(super) fn complaints(&self, sizes: &Sizes) -> Vec<String> {
        let mut complaints = Vec::new();
        for (name, size) in sizes {
            let Some(accepted) = self.images.get(name) else {
                complaints.push(format!("{name} is not in the baseline"));
                continue;
            };
            let measures = [
                ("flash", size.flash, accepted.flash),
                ("RAM", size.ram, accepted.ram),
                ("flash of the core", size.core_flash, accepted.core_flash),
                ("RAM of the core", size.core_ram, accepted.core_ram),
            ];
            for (what, now, before) in measures {
                let more = (before * self.tolerance_percent / 100).max(SMALL);
                if now > before + more {
                    complaints.push(format!("{name}: {what} grew from {before} to {now} bytes"));
                }
            }
        }
        let gone = self.images.keys().filter(|name| !sizes.contains_key(*name));
        complaints.extend(gone.map(|name| format!("{name} is in the baseline but was not built")));
        complaints
    }
}

const TOLERANCE_PERCENT: u64 = 1;

/// Bytes that any number may grow by: a hundredth of almost nothing is nothing.
const SMALL: u64 = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::size::ImageSize;

    fn sizes(name: &str, flash: u64) -> Sizes {
        let size = ImageSize { flash, ram: 1000, core_flash: 500, core_ram: 100 };
        [(name.to_owned(), size)].into()
    }

    #[test]
    fn growth_within_the_tolerance_passes() {
        let baseline = Baseline::of(&sizes("sensor", 10_000));
        assert!(baseline.complaints(&sizes("sensor", 10_100)).is_empty());
        assert!(baseline.complaints(&sizes("sensor", 1)).is_empty());
        let complaints = baseline.complaints(&sizes("sensor", 10_101));
        assert_eq!(complaints, ["sensor: flash grew from 10000 to 10101 bytes"]);
    }

    #[test]
    fn small_numbers_may_grow_by_more() {
        let baseline = Baseline::of(&sizes("smoke", 100));
        assert!(baseline.complaints(&sizes("smoke", 164)).is_empty());
        assert_eq!(baseline.complaints(&sizes("smoke", 165)).len(), 1);
    }

    #[test]
    fn images_that_come_or_go_are_told() {
        let baseline = Baseline::of(&sizes("sensor", 10_000));
        let complaints = baseline.complaints(&sizes("brake", 10_000));
        assert_eq!(
            complaints,
            ["brake is not in the baseline", "sensor is in the baseline but was not built"]
        );
    }

    #[test]
    fn what_was_written_is_read_again() {
        let path = std::env::temp_dir().join(format!("xtask-baseline-{}.json", std::process::id()));
        let baseline = Baseline::of(&sizes("sensor", 10_000));
        baseline.write(&path).unwrap();
        assert_eq!(Baseline::read(&path).unwrap(), baseline);
        fs::write(&path, "{}").unwrap();
        assert!(Baseline::read(&path).unwrap_err().to_string().contains("is no baseline"));
        fs::remove_file(&path).unwrap();
        assert!(Baseline::read(&path).unwrap_err().to_string().contains("cannot be read"));
    }
}
