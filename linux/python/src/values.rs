//! Values between Python and the codec of the planner, and what else is handed over.

use std::time::Duration;

use cosmic_core::time;
use cosmic_plan::contents::{FieldLayout, Layout, Value};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyList};

/// A value as Python has it: a name for a value with a name, a float for one with a scale.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Boolean(value) => PyBool::new(py, *value).to_owned().into_any(),
        Value::Integer(value) => value.into_pyobject(py)?.into_any(),
        Value::Scaled(value) => PyFloat::new(py, value.as_f64()).into_any(),
        Value::Single(value) => PyFloat::new(py, f64::from(*value)).into_any(),
        Value::Double(value) => PyFloat::new(py, *value).into_any(),
        Value::Label { name, .. } => name.into_pyobject(py)?.into_any(),
        Value::List(values) => {
            let values: Vec<_> = values.iter().map(|value| to_python(py, value)).collect::<PyResult<_>>()?;
            PyList::new(py, values)?.into_any()
        }
    })
}

/// The bytes of a content: bytes as they are, or a dict with each field, encoded as the layout says.
pub(crate) fn content(given: &Bound<'_, PyAny>, layout: Option<&Layout>) -> PyResult<Vec<u8>> {
    if let Ok(bytes) = given.cast::<PyBytes>() {
        return Ok(bytes.as_bytes().to_vec());
    }
    let Ok(fields) = given.cast::<PyDict>() else {
        return Err(PyTypeError::new_err("the content is neither bytes nor a dict of its fields"));
    };
    let layout = layout.ok_or_else(|| {
        PyValueError::new_err(
            "no cluster file describes the fields of this channel: give one by cluster=, or the content as bytes",
        )
    })?;
    let mut words = Vec::with_capacity(fields.len());
    for (name, value) in fields.iter() {
        let name: String = name.extract()?;
        let word = match layout.field(&name) {
            Some(field) => word(field, &value)?,
            // The codec says that there is no such field.
            None => String::new(),
        };
        words.push((name, word));
    }
    let pairs: Vec<(&str, &str)> = words.iter().map(|(name, word)| (name.as_str(), word.as_str())).collect();
    layout
        .encode_text(&pairs)
        .map_err(|why| PyValueError::new_err(format!("this is no {}: {why}", layout.name)))
}

/// A value as the codec reads it.
fn word(field: &FieldLayout, value: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(value.is_true().to_string());
    }
    if let Ok(value) = value.cast::<PyFloat>() {
        // Rust writes it without an exponent; and a field of whole numbers takes 2.0 for 2.
        return Ok(value.value().to_string());
    }
    if field.count.is_some()
        && let Ok(values) = value.try_iter()
    {
        let words: Vec<String> = values.map(|value| word_of_one(field, &value?)).collect::<PyResult<_>>()?;
        return Ok(words.join(","));
    }
    Ok(value.str()?.to_string())
}

fn word_of_one(field: &FieldLayout, value: &Bound<'_, PyAny>) -> PyResult<String> {
    // A list of lists is no value of any field.
    word(&FieldLayout { count: None, ..field.clone() }, value)
}

/// A span in seconds.
pub(crate) fn span(seconds: f64, name: &str) -> PyResult<Duration> {
    let span = Duration::try_from_secs_f64(seconds).ok().filter(|span| span.as_secs() < LONGEST_S);
    span.ok_or_else(|| PyValueError::new_err(format!("{name} is {seconds}: give seconds, from 0 to a year")))
}

/// A span in seconds, of an event or a channel.
pub(crate) fn event_span(seconds: Option<f64>, name: &str) -> PyResult<Option<time::Duration>> {
    let span = seconds.map(|seconds| span(seconds, name)).transpose()?;
    Ok(span.map(|span| time::Duration::from_ticks(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX / 2))))
}

const LONGEST_S: u64 = 366 * 24 * 3_600;
