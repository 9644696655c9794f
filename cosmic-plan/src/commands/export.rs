//! `cosmic-plan export`: what other tools and languages need.

use super::support::{Failure, Planned, cluster, planned, write};
use clap::ValueEnum;
use cosmic_plan::cluster::Cluster;
use cosmic_plan::output::{c, dbc, html, lua, python};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What a cluster is exported to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Format {
    /// A DBC file: each message once for each publisher.
    Dbc,
    /// A DBC file in which soft messages stand once for every identifier that they may have.
    DbcEvery,
    /// A header of C99.
    C,
    /// A module of Python.
    Python,
    /// A dissector for Wireshark.
    Lua,
    /// A page about the cluster.
    Html,
}

impl Format {
    /// The name of the file, of this segment.
    fn file_name(self, segment: &str) -> String {
        match self {
            Self::Dbc => format!("{segment}.dbc"),
            Self::DbcEvery => format!("{segment}_every.dbc"),
            Self::C => format!("{segment}.h"),
            Self::Python => format!("{segment}.py"),
            Self::Lua => format!("{segment}.lua"),
            Self::Html => format!("{segment}.html"),
        }
    }
}

/// Writes one of the formats, or all.
pub(super) fn export(file: &Path, format: Option<Format>, out: Option<&Path>) -> Result<ExitCode, Failure> {
    let name = source_name(file);
    // Only the page says what was proven; all else needs no plan.
    let planned =
        if matches!(format, None | Some(Format::Html)) { Some(planned(file, false)?) } else { None };
    let read;
    let cluster = match &planned {
        Some(planned) => &planned.cluster,
        None => {
            read = cluster(file, false)?;
            &read
        }
    };
    let folder = match (format, out) {
        (Some(format), Some(out)) => return one(&rendered(format, cluster, planned.as_ref(), &name), out),
        (_, out) => out.unwrap_or(Path::new(".")),
    };
    std::fs::create_dir_all(folder).map_err(|error| {
        Failure::Line(format!("{} cannot be made: {error}; choose another --out", folder.display()))
    })?;
    let formats = format.map_or(Format::value_variants().to_vec(), |format| vec![format]);
    for format in formats {
        let path = folder.join(format.file_name(&cluster.name));
        one(&rendered(format, cluster, planned.as_ref(), &name), &path)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn one(bytes: &[u8], path: &Path) -> Result<ExitCode, Failure> {
    write(path, bytes)?;
    println!("wrote {}", path.display());
    Ok(ExitCode::SUCCESS)
}

fn rendered(format: Format, cluster: &Cluster, planned: Option<&Planned>, name: &str) -> Vec<u8> {
    match (format, planned) {
        (Format::Dbc, _) => dbc::encode(&dbc::render(cluster, dbc::Identifiers::One)),
        (Format::DbcEvery, _) => dbc::encode(&dbc::render(cluster, dbc::Identifiers::Every)),
        (Format::C, _) => c::render(cluster, name).into_bytes(),
        (Format::Python, _) => python::render(cluster, name).into_bytes(),
        (Format::Lua, _) => lua::render(cluster, name).into_bytes(),
        (Format::Html, Some(planned)) => {
            html::render(cluster, &planned.plan, &planned.assessment, name).into_bytes()
        }
        (Format::Html, None) => Vec::new(),
    }
}

/// What the exported files call the description.
pub(super) fn source_name(file: &Path) -> String {
    file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Writes all formats into a folder, and says which files they are.
pub(super) fn all(planned: &Planned, name: &str, folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for format in Format::value_variants() {
        let path = folder.join(format.file_name(&planned.cluster.name));
        write(&path, &rendered(*format, &planned.cluster, Some(planned), name))?;
        files.push(path);
    }
    Ok(files)
}
