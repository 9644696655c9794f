//! A simulated segment in this process, to try things without hardware.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use cosmic_bus::{Bus, FaultModel};
use cosmic_core::can::BitRate;
use cosmic_linux::link::segment::{Options, SimulatedSegment, Socket};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tokio::runtime::{Builder, Runtime};
use tokio::task::JoinHandle;

use crate::errors::LinkError;

/// A simulated segment, served at a Unix socket.
#[pyclass(frozen, module = "cosmic_can._native")]
pub(crate) struct Segment {
    path: PathBuf,
    /// `None` when it has been closed.
    served: Mutex<Option<(Runtime, JoinHandle<()>)>>,
}

#[pymethods]
impl Segment {
    #[new]
    fn new(py: Python<'_>, path: PathBuf, bit_rate: u32) -> PyResult<Self> {
        let rate = BitRate::new(bit_rate).ok_or_else(|| {
            PyValueError::new_err(format!("bit_rate is {bit_rate}: give one from 10000 to 1000000"))
        })?;
        let runtime =
            Builder::new_multi_thread().worker_threads(1).thread_name("segment").enable_all().build();
        let runtime =
            runtime.map_err(|why| LinkError::new_err(format!("no thread can be started: {why}")))?;
        let socket = py.detach(|| runtime.block_on(Socket::bind(&path)));
        let socket = socket.map_err(|why| LinkError::new_err(why.to_string()))?;
        let segment = SimulatedSegment::new(Bus::new(rate, FaultModel::none()));
        let serving = runtime.spawn(async move {
            // It ends when it is aborted.
            let _ = socket.serve(segment, Options::default()).await;
        });
        Ok(Self { path, served: Mutex::new(Some((runtime, serving))) })
    }

    /// What a node is to connect to.
    #[getter]
    fn link(&self) -> String {
        format!("sim:{}", self.path.display())
    }

    fn close(&self, py: Python<'_>) {
        let served = self.served.lock().unwrap_or_else(PoisonError::into_inner).take();
        py.detach(|| {
            if let Some((runtime, serving)) = served {
                serving.abort();
                // The file of the socket goes with what serves it.
                let _ = runtime.block_on(serving);
                runtime.shutdown_background();
            }
        });
    }
}
