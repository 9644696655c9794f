//! A simulated segment in this process, to try things without hardware.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use cosmic_bus::{Bus, FaultModel};
use cosmic_core::can::BitRate;
use cosmic_linux::link::segment::{Options, SimulatedSegment, serve};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tokio::runtime::{Builder, Runtime};

use crate::errors::LinkError;

/// A simulated segment, served at a Unix socket.
#[pyclass(frozen, module = "cosmic_can._native")]
pub(crate) struct Segment {
    path: PathBuf,
    runtime: Mutex<Option<Runtime>>,
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
        let at = path.clone();
        let served = runtime.spawn(async move {
            let Err(why) =
                serve(&at, SimulatedSegment::new(Bus::new(rate, FaultModel::none())), Options::default())
                    .await;
            why.to_string()
        });
        let begun = Instant::now();
        while std::os::unix::net::UnixStream::connect(&path).is_err() {
            if served.is_finished() {
                let why = runtime.block_on(served).unwrap_or_else(|why| why.to_string());
                return Err(LinkError::new_err(why));
            }
            if begun.elapsed() > PATIENCE {
                return Err(LinkError::new_err(format!("nothing can be served at {}", path.display())));
            }
            py.detach(|| std::thread::sleep(Duration::from_millis(1)));
        }
        Ok(Self { path, runtime: Mutex::new(Some(runtime)) })
    }

    /// What a node is to connect to.
    #[getter]
    fn link(&self) -> String {
        format!("sim:{}", self.path.display())
    }

    fn close(&self) {
        if let Some(runtime) = self.runtime.lock().unwrap_or_else(PoisonError::into_inner).take() {
            runtime.shutdown_background();
            // The socket is no use without its server.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

const PATIENCE: Duration = Duration::from_secs(10);
