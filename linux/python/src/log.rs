//! Logs as columns.

use std::path::{Path, PathBuf};

use cosmic_core::Subject;
use cosmic_core::can::{BitRate, Frame};
use cosmic_core::time::Instant;
use cosmic_linux::{Tapped, What};
use cosmic_log::{Heard, LogError};
use cosmic_monitor::{Decoded, Monitor, SegmentPlan};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::event::decode;
use crate::values;

/// Reads a log into columns.
#[pyfunction]
#[pyo3(signature = (path, *, cluster=None, channel=None))]
pub(crate) fn read_log<'py>(
    py: Python<'py>,
    path: PathBuf,
    cluster: Option<PathBuf>,
    channel: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let plan = cluster.map(SegmentPlan::read).transpose();
    let plan = plan.map_err(|why| PyValueError::new_err(why.to_string()))?;
    let log = Log::open(&path, plan.as_ref())?;
    match channel {
        None => all(py, log),
        Some(channel) => {
            let chosen = Chosen::new(plan.as_ref(), channel)?;
            events(py, log, plan.as_ref(), &chosen)
        }
    }
}

/// The frames of a log, with what a listener knows of each when it comes.
struct Log(Heard);

/// A frame of a log.
struct Row {
    /// Seconds since 1970.
    time: f64,
    frame: Frame,
    decoded: Decoded,
    /// The content that ends with this frame: of a message of several frames the whole, with its last frame.
    content: Option<Vec<u8>>,
}

impl Log {
    fn open(path: &Path, plan: Option<&SegmentPlan>) -> PyResult<Self> {
        let monitor = match plan {
            Some(plan) => Monitor::with_plan(plan.clone(), Instant::EPOCH),
            None => Monitor::new(BitRate::MAX, Instant::EPOCH),
        };
        Heard::open(path, monitor).map(Self).map_err(refused)
    }
}

impl Iterator for Log {
    type Item = PyResult<Row>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.0.next()? {
                Ok((stamp, Tapped { what: What::Frame(frame), .. })) => {
                    let monitor = self.0.monitor();
                    let (decoded, content) = (monitor.decode(&frame), monitor.content_whole(&frame));
                    return Some(Ok(Row { time: stamp.as_secs_f64(), frame, decoded, content }));
                }
                Ok(_) => {}
                Err(why) => return Some(Err(refused(why))),
            }
        }
    }
}

fn refused(why: LogError) -> PyErr {
    PyValueError::new_err(why.to_string())
}

/// A row for each frame.
fn all(py: Python<'_>, log: Log) -> PyResult<Bound<'_, PyDict>> {
    let columns = Columns::new(
        py,
        ["time", "class", "priority", "tx_node", "node", "etag", "channel", "data", "text"]
            .map(str::to_owned)
            .into(),
    );
    for row in log {
        let Row { time, frame, decoded, .. } = row?;
        let text = decoded.to_string();
        columns.lists[0].append(time)?;
        columns.lists[1].append(decoded.class)?;
        columns.lists[2].append(decoded.priority)?;
        columns.lists[3].append(decoded.tx_node)?;
        columns.lists[4].append(decoded.node)?;
        columns.lists[5].append(decoded.etag)?;
        columns.lists[6].append(decoded.channel.or(decoded.subject))?;
        columns.lists[7].append(pyo3::types::PyBytes::new(py, frame.payload.as_slice()))?;
        columns.lists[8].append(text)?;
    }
    columns.dict()
}

/// The channel that was asked for.
struct Chosen {
    /// Its position in the plan.
    planned: Option<usize>,
    subject: String,
}

impl Chosen {
    fn new(plan: Option<&SegmentPlan>, channel: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(name) = channel.extract::<String>() {
            let found = plan.and_then(|plan| {
                let at = plan.channel_named(&name)?;
                Some((at, Subject::new(plan.channel(at).subject)?))
            });
            let (at, subject) = found.ok_or_else(|| {
                let remedy = match plan {
                    Some(_) => "names stand in the cluster file",
                    None => "give the cluster file by cluster=, or a subject",
                };
                PyValueError::new_err(format!("there is no channel {name:?}: {remedy}"))
            })?;
            return Ok(Self { planned: Some(at), subject: subject.to_string() });
        }
        let number: u64 = channel
            .extract()
            .map_err(|_| PyTypeError::new_err("a channel is named by a str, or by its subject"))?;
        let subject =
            Subject::new(number).ok_or_else(|| PyValueError::new_err("the subject is 0, which is none"))?;
        let planned = plan.and_then(|plan| plan.channel_of_subject(subject));
        Ok(Self { planned, subject: subject.to_string() })
    }
}

/// A row for each event of a channel, and a column for each field.
fn events<'py>(
    py: Python<'py>,
    log: Log,
    plan: Option<&SegmentPlan>,
    chosen: &Chosen,
) -> PyResult<Bound<'py, PyDict>> {
    let planned = plan.zip(chosen.planned);
    let layout = planned.and_then(|(plan, at)| plan.cluster().layout_of(plan.channel(at)));
    let fields: Vec<&str> = layout
        .map_or_else(Vec::new, |layout| layout.fields.iter().map(|field| field.name.as_str()).collect());
    let mut names = vec!["time".to_owned(), "tx_node".to_owned(), "node".to_owned()];
    for field in if fields.is_empty() { &["data"] } else { fields.as_slice() } {
        // A field may have the name of a column that is there.
        names.push(if names.iter().any(|name| name == field) {
            format!("content.{field}")
        } else {
            (*field).to_owned()
        });
    }
    let columns = Columns::new(py, names);
    for row in log {
        let Row { time, decoded, content, .. } = row?;
        let Some(content) = content else { continue };
        if decoded.subject.as_ref() != Some(&chosen.subject) {
            continue;
        }
        columns.lists[0].append(time)?;
        columns.lists[1].append(decoded.tx_node)?;
        columns.lists[2].append(decoded.node)?;
        if fields.is_empty() {
            columns.lists[3].append(pyo3::types::PyBytes::new(py, &content))?;
            continue;
        }
        let values = planned.and_then(|(plan, at)| decode(plan, at, &content).ok()).unwrap_or_default();
        for (place, column) in columns.lists[3..].iter().enumerate() {
            // Nothing stands where the content is none.
            match values.get(place) {
                Some(field) => column.append(values::to_python(py, &field.value)?)?,
                None => column.append(py.None())?,
            }
        }
    }
    columns.dict()
}

struct Columns<'py> {
    py: Python<'py>,
    names: Vec<String>,
    lists: Vec<Bound<'py, PyList>>,
}

impl<'py> Columns<'py> {
    fn new(py: Python<'py>, names: Vec<String>) -> Self {
        let lists = names.iter().map(|_| PyList::empty(py)).collect();
        Self { py, names, lists }
    }

    fn dict(self) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(self.py);
        for (name, list) in self.names.iter().zip(self.lists) {
            dict.set_item(name, list)?;
        }
        Ok(dict)
    }
}
