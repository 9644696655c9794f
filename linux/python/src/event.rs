//! An event, as Python sees it.

use cosmic_core::Subject;
use cosmic_core::event_layer::Delivered;
use cosmic_monitor::{SegmentPlan, hex_text};
use cosmic_plan::contents::Field;
use cosmic_session::{Session, Subscription};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::values;

/// An event of a channel.
#[pyclass(frozen, module = "cosmic_can")]
pub(crate) struct Event {
    /// The name of the channel, or its subject in hexadecimal digits.
    #[pyo3(get)]
    channel: String,
    #[pyo3(get)]
    subject: u64,
    /// The TxNode of the publisher.
    #[pyo3(get)]
    publisher: u8,
    /// Its name in the cluster's file.
    #[pyo3(get)]
    node: Option<String>,
    /// When it arrived: nanoseconds of `time.monotonic_ns()`.
    #[pyo3(get)]
    received_ns: u64,
    /// Why the content could not be decoded.
    #[pyo3(get)]
    malformed: Option<String>,
    data: Vec<u8>,
    fields: Py<PyDict>,
    units: Py<PyDict>,
    text: String,
}

impl Event {
    pub(crate) fn new(
        py: Python<'_>,
        session: &Session,
        subscription: &Subscription,
        subject: Subject,
        event: &Delivered<Vec<u8>>,
    ) -> PyResult<Self> {
        let plan = session.plan();
        let at = plan.and_then(|plan| plan.channel_of_subject(subject));
        let node = plan.and_then(|plan| plan.node(event.publisher)).map(|node| node.name.clone());
        let channel = plan.zip(at).map(|(plan, at)| plan.channel(at).name.clone());
        let channel = channel.unwrap_or_else(|| name_of(subject));
        let (fields, units) = (PyDict::new(py), PyDict::new(py));
        let from = node.clone().unwrap_or_else(|| format!("node {}", event.publisher));
        let mut text = format!("{channel} from {from}: ");
        let mut malformed = None;
        match plan.zip(at).map(|(plan, at)| decode(plan, at, &event.content)) {
            Some(Ok(decoded)) if !decoded.is_empty() => {
                let mut words = Vec::new();
                for field in decoded {
                    fields.set_item(field.name, values::to_python(py, &field.value)?)?;
                    units.set_item(field.name, field.unit)?;
                    words.push(word(&field));
                }
                text += &words.join(" ");
            }
            Some(Err(why)) => {
                text += &format!("{} (malformed: {why})", hex_text(&event.content));
                malformed = Some(why);
            }
            _ => text += &hex_text(&event.content),
        }
        Ok(Self {
            channel,
            subject: subject.get(),
            publisher: event.publisher.get(),
            node,
            received_ns: subscription.received_ns(event),
            malformed,
            data: event.content.clone(),
            fields: fields.unbind(),
            units: units.unbind(),
            text,
        })
    }
}

#[pymethods]
impl Event {
    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.data)
    }

    #[getter]
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.fields.bind(py).copy()
    }

    #[getter]
    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.units.bind(py).copy()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let value = self.fields.bind(py).get_item(name)?;
        value.ok_or_else(|| PyKeyError::new_err(format!("{} has no field {name:?}", self.channel)))
    }

    fn __str__(&self) -> &str {
        &self.text
    }

    fn __repr__(&self) -> String {
        format!("<Event {}>", self.text)
    }
}

/// The fields of a content; none if the description does not say what stands in it.
pub(crate) fn decode<'plan>(
    plan: &'plan SegmentPlan,
    channel: usize,
    bytes: &[u8],
) -> Result<Vec<Field<'plan>>, String> {
    let channel = plan.channel(channel);
    let layout = plan.cluster().layout_of(channel);
    let Some(layout) = layout else { return Ok(Vec::new()) };
    layout.decode(bytes).map_err(|why| why.to_string())
}

fn word(field: &Field<'_>) -> String {
    let unit = field.unit.map(|unit| format!(" {unit}")).unwrap_or_default();
    format!("{}={}{unit}", field.name, field.value)
}

/// What a channel without a name is called.
pub(crate) fn name_of(subject: Subject) -> String {
    format!("{:#X}", subject.get())
}
