//! What stands between the gateways: it is slow, and can be cut.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration as Span;

use cosmic_wan::{Direction, State, Way};

use crate::failed::Failed;
use crate::ground::{FAR, Ground, NEAR, Wire};

/// What stands between the gateways.
pub struct Between {
    wire: Option<Wire>,
    /// Delays, where the kernel does not.
    way: Option<Way>,
    /// Where the gateway of the east finds that of the west.
    near: SocketAddr,
    /// Which of all this it is.
    words: String,
}

impl Between {
    /// Lays it between the gateway of the west, at this port, and the process of that of the east.
    ///
    /// # Errors
    /// The kernel refuses something.
    pub async fn lay(ground: &Ground, delay: Span, port: u16, far: u32) -> Result<Self, Failed> {
        let milliseconds = delay.as_secs_f64() * 1e3;
        match ground {
            Ground::Loopback(why) => {
                let way = slow(LOOPBACK, port, delay).await?;
                let words =
                    format!("the loopback interface, and a proxy that delays by {milliseconds} ms ({why})");
                Ok(Self { near: way.address(), way: Some(way), wire: None, words })
            }
            Ground::Apart => {
                let wire = Wire::lay(far, delay)?;
                let place = "two network namespaces, joined by a pair of veth";
                if wire.delays {
                    let words = format!("{place}; netem delays by {milliseconds} ms");
                    return Ok(Self {
                        near: SocketAddr::new(NEAR, port),
                        way: None,
                        wire: Some(wire),
                        words,
                    });
                }
                let way = slow(NEAR, port, delay).await?;
                let words =
                    format!("{place}; a proxy delays by {milliseconds} ms, for this kernel has no netem");
                Ok(Self { near: way.address(), way: Some(way), wire: Some(wire), words })
            }
        }
    }

    /// Where the gateway of the east finds that of the west.
    pub const fn near(&self) -> SocketAddr {
        self.near
    }

    /// Where the gateway of the east is.
    pub const fn far(&self) -> IpAddr {
        if self.wire.is_some() { FAR } else { LOOPBACK }
    }

    /// What the gateway of the west listens at.
    pub fn listens(&self) -> Vec<IpAddr> {
        // The loopback interface stays up when the wire goes down.
        let direct = self.way.is_none().then_some(NEAR);
        [LOOPBACK].into_iter().chain(direct).collect()
    }

    /// What it is, for the report.
    pub fn words(&self) -> &str {
        &self.words
    }

    /// Cuts it, or heals it.
    ///
    /// # Errors
    /// The kernel refuses it.
    pub fn set_cut(&self, is_cut: bool) -> Result<(), Failed> {
        match (&self.wire, &self.way) {
            (Some(wire), _) => wire.set(!is_cut),
            (None, Some(way)) => {
                way.set(if is_cut { State::Cut } else { State::Open });
                Ok(())
            }
            (None, None) => Ok(()),
        }
    }
}

async fn slow(address: IpAddr, port: u16, delay: Span) -> Result<Way, Failed> {
    let way = Way::from(address, SocketAddr::new(LOOPBACK, port)).await;
    let way = way.map_err(|error| Failed(format!("no port: {error}")))?;
    way.delay(Direction::There, delay);
    way.delay(Direction::Back, delay);
    Ok(way)
}

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
