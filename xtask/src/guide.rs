//! Follows `docs/write-your-own-node.md` in a repository, as a reader does: each block of code goes into the file that
//! the line above it names.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result};

use crate::workspace::Workspace;

/// The guide's text.
pub(crate) fn text(workspace: &Workspace) -> Result<String> {
    let path = workspace.root().join("docs/write-your-own-node.md");
    fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))
}

/// Writes the blocks into the files of a repository: behind what is there, or into a file of their own.
pub(crate) fn follow(guide: &str, repository: &Path) -> Result<()> {
    for Block { file, code } in blocks(guide) {
        let path = repository.join(file);
        let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
        write!(file, "\n{code}").with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

/// Code for a file.
struct Block<'a> {
    file: &'a str,
    code: &'a str,
}

fn blocks(guide: &str) -> Vec<Block<'_>> {
    let mut blocks = Vec::new();
    for language in ["```toml\n", "```rust\n"] {
        let mut rest = guide;
        while let Some((before, behind)) = rest.split_once(language) {
            let (code, after) = behind.split_once("```\n").unwrap_or((behind, ""));
            // The last word in backticks of the line above.
            let file = before.trim_end().rsplit('`').nth(1);
            blocks.extend(file.map(|file| Block { file, code }));
            rest = after;
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_guide_has_blocks_for_three_files() {
        let guide = text(&Workspace::find().unwrap()).unwrap();
        let files: Vec<_> = blocks(&guide).iter().map(|block| block.file).collect();
        assert_eq!(files, ["cluster.toml", "src/lib.rs", "src/bin/gripper.rs"]);
        let lines = blocks(&guide)[2].code.lines().count();
        assert!(lines <= 60, "the application has {lines} lines");
    }
}
