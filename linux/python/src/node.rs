//! A node.

use std::sync::Arc;

use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{Depth, ExceptionKind, Importance};
use cosmic_core::{NodeUid, Subject};
use cosmic_session::{Class, Failure, Quality, Queue, Session, Settings, Times};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::raised;
use crate::subscription::Subscription;
use crate::values;

/// A node on a segment.
#[pyclass(frozen, module = "cosmic_can._native")]
pub(crate) struct Node {
    session: Arc<Session>,
}

impl Node {
    fn session(&self) -> PyResult<&Arc<Session>> {
        if self.session.is_closed() { Err(raised(&Failure::Closed)) } else { Ok(&self.session) }
    }
}

/// A quality that was given, if any part of it was.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct GivenQuality {
    deadline: Option<f64>,
    validity: Option<f64>,
    importance: Option<u8>,
    etag: Option<u16>,
    messages: bool,
}

impl GivenQuality {
    fn quality(&self) -> PyResult<Option<Quality>> {
        let Self { deadline, validity, importance, etag, messages } = *self;
        if deadline.is_none() && validity.is_none() && importance.is_none() && etag.is_none() && !messages {
            return Ok(None);
        }
        let etag = etag.map(|number| {
            Etag::new(number)
                .ok_or_else(|| PyValueError::new_err(format!("etag is {number}: give one of 1024 to 16383")))
        });
        let (deadline, validity) =
            (values::event_span(deadline, "deadline")?, values::event_span(validity, "validity")?);
        let class = match importance {
            Some(_) if deadline.is_some() => {
                return Err(PyValueError::new_err(
                    "a channel with an importance is non real-time, and has no deadline",
                ));
            }
            None if messages && deadline.is_some() => {
                return Err(PyValueError::new_err(
                    "a channel of messages is non real-time, and has no deadline",
                ));
            }
            None if messages => Class::Messages { importance: Importance::LEAST, validity },
            Some(rank) => {
                let importance = Importance::new(rank).ok_or_else(|| {
                    PyValueError::new_err(format!("importance is {rank}: give 0, the most, to 4"))
                })?;
                if messages {
                    Class::Messages { importance, validity }
                } else {
                    Class::NonRealTime { importance, validity }
                }
            }
            None => {
                let Class::Soft { deadline: usual, .. } = Quality::DEFAULT.class else {
                    return Err(PyTypeError::new_err("the default quality is soft real-time"));
                };
                let deadline = deadline.unwrap_or(usual);
                Class::Soft { deadline, validity: validity.unwrap_or(deadline * 4) }
            }
        };
        Ok(Some(Quality { class, etag: etag.transpose()? }))
    }
}

fn subject_of(session: &Session, channel: &Bound<'_, PyAny>) -> PyResult<Subject> {
    if let Ok(number) = channel.extract::<u64>() {
        return Subject::new(number).ok_or_else(|| PyValueError::new_err("the subject is 0, which is none"));
    }
    let name: String = channel
        .extract()
        .map_err(|_| PyTypeError::new_err("a channel is named by a str, or by its subject"))?;
    session.subject_of(&name).ok_or_else(|| {
        let remedy = match session.plan() {
            Some(_) => "names stand in the cluster file",
            None => "give the cluster file by cluster=, or a subject",
        };
        PyValueError::new_err(format!("there is no channel {name:?}: {remedy}"))
    })
}

#[pymethods]
impl Node {
    #[new]
    #[pyo3(signature = (link, *, cluster, uid, tx_node, bit_rate, patience))]
    fn new(
        py: Python<'_>,
        link: &str,
        cluster: Option<std::path::PathBuf>,
        uid: Option<u64>,
        tx_node: Option<u8>,
        bit_rate: u32,
        patience: f64,
    ) -> PyResult<Self> {
        let value = |what: String| PyValueError::new_err(what);
        let mut settings = Settings::new(link.parse().map_err(|why| value(format!("{link:?}: {why}")))?);
        settings.cluster = cluster;
        settings.patience = values::span(patience, "patience")?;
        settings.bit_rate = BitRate::new(bit_rate)
            .ok_or_else(|| value(format!("bit_rate is {bit_rate}: give one from 10000 to 1000000")))?;
        settings.uid = uid
            .map(|uid| NodeUid::new(uid).ok_or_else(|| value("uid is 0, which is none".to_owned())))
            .transpose()?;
        settings.tx_node = tx_node
            .map(|node| {
                let found = TxNode::new(node).filter(|node| *node != TxNode::BROKER);
                found.ok_or_else(|| value(format!("tx_node is {node}: give one from 0 to 126")))
            })
            .transpose()?;
        let session = py.detach(|| Session::open(&settings)).map_err(|why| raised(&why))?;
        Ok(Self { session: Arc::new(session) })
    }

    /// The names of the channels in the cluster's file.
    #[getter]
    fn channels(&self) -> PyResult<Vec<String>> {
        let session = self.session()?;
        let channels = session.plan().map(|plan| plan.cluster().channels.iter());
        Ok(channels.into_iter().flatten().map(|channel| channel.name.clone()).collect())
    }

    #[getter]
    fn tx_node(&self) -> PyResult<Option<u8>> {
        Ok(self.session()?.node().tx_node().map(TxNode::get))
    }

    #[getter]
    fn is_connected(&self) -> PyResult<bool> {
        Ok(self.session()?.node().is_connected())
    }

    fn announce(&self, py: Python<'_>, channel: &Bound<'_, PyAny>, quality: GivenQuality) -> PyResult<()> {
        let session = self.session()?;
        let (subject, quality) = (subject_of(session, channel)?, quality.quality()?);
        py.detach(|| session.announce(subject, quality.as_ref())).map_err(|why| raised(&why))
    }

    fn withdraw(&self, channel: &Bound<'_, PyAny>) -> PyResult<bool> {
        let session = self.session()?;
        Ok(session.withdraw(subject_of(session, channel)?))
    }

    #[pyo3(signature = (channel, content, deadline=None, validity=None))]
    fn publish(
        &self,
        py: Python<'_>,
        channel: &Bound<'_, PyAny>,
        content: &Bound<'_, PyAny>,
        deadline: Option<f64>,
        validity: Option<f64>,
    ) -> PyResult<()> {
        let session = self.session()?;
        let subject = subject_of(session, channel)?;
        let plan = session.plan();
        let layout = plan.and_then(|plan| {
            let at = plan.channel_of_subject(subject)?;
            plan.cluster().layout_of(plan.channel(at))
        });
        let content = values::content(content, layout)?;
        let times = Times {
            deadline: values::event_span(deadline, "deadline")?,
            validity: values::event_span(validity, "validity")?,
        };
        py.detach(|| session.publish(subject, &content, times)).map_err(|why| raised(&why))
    }

    fn subscribe(
        &self,
        py: Python<'_>,
        channel: &Bound<'_, PyAny>,
        depth: u8,
        quality: GivenQuality,
    ) -> PyResult<Subscription> {
        let session = self.session()?;
        let (subject, quality) = (subject_of(session, channel)?, quality.quality()?);
        let queue = Depth::new(depth).map_or(Queue::Latest, Queue::InOrder);
        let subscription = py.detach(|| session.subscribe(subject, quality.as_ref(), queue));
        let subscription = subscription.map_err(|why| raised(&why))?;
        Ok(Subscription { session: Arc::clone(session), subscription, subject })
    }

    /// What happened on a channel at this node: nothing if it does not use it.
    fn counters<'py>(&self, py: Python<'py>, channel: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyDict>> {
        let session = self.session()?;
        let counters = session.counters(subject_of(session, channel)?).unwrap_or_default();
        let dict = PyDict::new(py);
        for (name, count) in [
            ("published", counters.published),
            ("refused", counters.refused),
            ("sent", counters.sent),
            ("expired", counters.discarded),
            ("delivered", counters.delivered),
            ("overflowed", counters.overflowed),
            ("replaced", counters.replaced),
            ("malformed", counters.malformed),
        ] {
            dict.set_item(name, count)?;
        }
        Ok(dict)
    }

    /// How often what did not happen as promised, by kind; kinds that did not occur are left out.
    fn exceptions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let session = self.session()?;
        let dict = PyDict::new(py);
        for kind in ExceptionKind::ALL {
            match session.node().exceptions(*kind) {
                0 => {}
                count => dict.set_item(kind.name(), count)?,
            }
        }
        Ok(dict)
    }

    fn close(&self, py: Python<'_>) {
        py.detach(|| self.session.close());
    }
}
