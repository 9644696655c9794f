//! The table of a broker on disk: what the next start begins with.
//!
//! It is written anew whenever it has changed, into a file beside it that then takes its name. So whenever the program is
//! killed, or the power fails, the file is either the old or the new one, and whole.

use std::fmt;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration as Span;

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::{BrokerTables, Node};
use cosmic_plan::document::file::read_text;
use serde::{Deserialize, Serialize};

/// The table of a broker on disk.
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    contents: BrokerTables,
}

/// The table cannot be read or written.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TableError(String);

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for TableError {}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    version: u8,
    nodes: Vec<(String, u8)>,
    subjects: Vec<(String, u16)>,
}

impl Table {
    /// The table in this file; an empty one if there is none yet.
    ///
    /// # Errors
    /// The file cannot be read or written, or is no table.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let wrong = |what: String| TableError(format!("the table of the broker, {}, {what}", path.display()));
        let contents = match read_text(path) {
            Ok(text) => read(&text).map_err(|why| {
                wrong(format!("is of no use: {why}; move it away to begin with an empty one"))
            })?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => BrokerTables::default(),
            Err(error) => return Err(wrong(format!("cannot be read: {error}"))),
        };
        let table = Self { path: path.to_owned(), contents };
        // Whether it can be written shows now, and not when the first node asks.
        table.write()?;
        Ok(table)
    }

    /// What stands in it.
    pub const fn contents(&self) -> &BrokerTables {
        &self.contents
    }

    /// Writes it, if it is another than what stands there.
    ///
    /// # Errors
    /// It cannot be written. What stood there still does.
    pub fn store(&mut self, contents: BrokerTables) -> Result<(), TableError> {
        if self.contents == contents {
            return Ok(());
        }
        let before = std::mem::replace(&mut self.contents, contents);
        self.write().inspect_err(|_| self.contents = before)
    }

    fn write(&self) -> Result<(), TableError> {
        self.replace().map_err(|error| {
            let path = self.path.display();
            TableError(format!("the table of the broker, {path}, cannot be written: {error}; its folder must exist and be writable"))
        })
    }

    fn replace(&self) -> std::io::Result<()> {
        let folder = match self.path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let mut name = self.path.file_name().unwrap_or_default().to_owned();
        name.push(".new");
        let new = folder.join(name);
        let mut file = std::fs::File::create(&new)?;
        file.write_all(write(&self.contents).as_bytes())?;
        file.sync_all()?;
        std::fs::rename(&new, &self.path)?;
        // The name is on the disk too, then.
        std::fs::File::open(folder)?.sync_all()
    }
}

fn write(contents: &BrokerTables) -> String {
    let document = Document {
        version: VERSION,
        nodes: contents.nodes.iter().map(|(uid, node)| (uid.to_string(), node.get())).collect(),
        subjects: contents.subjects.iter().map(|(subject, etag)| (subject.to_string(), etag.get())).collect(),
    };
    // Text and numbers are always JSON.
    serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
}

fn read(text: &str) -> Result<BrokerTables, String> {
    let document: Document = serde_json::from_str(text).map_err(|error| error.to_string())?;
    if document.version != VERSION {
        return Err(format!("it has version {}, not {VERSION}", document.version));
    }
    let number = |text: &str| u64::from_str_radix(text, 16).ok();
    let nodes = document.nodes.iter().map(|(uid, node)| {
        let entry = number(uid).and_then(NodeUid::new).zip(TxNode::new(*node));
        entry.ok_or_else(|| format!("{uid:?} with {node} is no node"))
    });
    let subjects = document.subjects.iter().map(|(subject, etag)| {
        let entry = number(subject).and_then(Subject::new).zip(Etag::new(*etag));
        entry.ok_or_else(|| format!("{subject:?} with {etag} is no subject"))
    });
    Ok(BrokerTables {
        nodes: nodes.collect::<Result<_, _>>()?,
        subjects: subjects.collect::<Result<_, _>>()?,
    })
}

/// Writes the table whenever the broker has changed it, for ever.
///
/// # Errors
/// It could not be written for [a while](PATIENCE): the broker must not go on without.
pub(crate) async fn keep(mut table: Table, node: &Node) -> Result<(), TableError> {
    let mut news = node.news();
    let mut failed_since: Option<tokio::time::Instant> = None;
    loop {
        if let Some(contents) = node.broker_tables() {
            let stored = tokio::task::block_in_place(|| table.store(contents));
            match stored {
                Ok(()) => failed_since = None,
                Err(error) => {
                    let since = *failed_since.get_or_insert_with(tokio::time::Instant::now);
                    tracing::error!("{error}");
                    if since.elapsed() > PATIENCE {
                        return Err(error);
                    }
                }
            }
        }
        let timer = tokio::time::sleep(LONGEST_DELAY);
        tokio::select! {
            _ = news.recv() => {}
            () = timer => {}
        }
    }
}

const VERSION: u8 = 1;
/// A disk may be full for so long.
const PATIENCE: Span = Span::from_secs(60);
/// News need not tell of everything.
const LONGEST_DELAY: Span = Span::from_millis(500);

#[cfg(test)]
mod tests {
    use super::*;

    fn contents(nodes: u8) -> BrokerTables {
        let nodes = (1..=nodes)
            .map(|node| (NodeUid::new(u64::from(node) << 40).unwrap(), TxNode::new(node).unwrap()))
            .collect();
        BrokerTables { nodes, subjects: vec![(Subject::new(0xAB).unwrap(), Etag::BOUND_LAST)] }
    }

    #[test]
    fn a_table_is_there_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table");
        let mut table = Table::open(&path).unwrap();
        assert_eq!(*table.contents(), BrokerTables::default());
        table.store(contents(100)).unwrap();
        table.store(contents(3)).unwrap();
        assert_eq!(*Table::open(&path).unwrap().contents(), contents(3));
        let files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
        assert_eq!(files.len(), 1, "nothing is left beside it");
    }

    #[test]
    fn what_is_no_table_is_refused_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table");
        for text in [
            "",
            "{}",
            "garbage",
            r#"{"version":2,"nodes":[],"subjects":[]}"#,
            r#"{"version":1,"nodes":[["0",1]],"subjects":[]}"#,
        ] {
            std::fs::write(&path, text).unwrap();
            let why = Table::open(&path).unwrap_err().to_string();
            assert!(why.contains("move it away"), "{why}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text, "it is left as it was");
        }
        let why = Table::open(&folder.path().join("no/table")).unwrap_err().to_string();
        assert!(why.contains("its folder must exist"), "{why}");
    }
}
