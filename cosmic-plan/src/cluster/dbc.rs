//! Foreign frames out of a DBC file. Without the feature `dbc`, such a file is refused.

use super::Foreign;
#[cfg(feature = "dbc")]
use crate::document::file;
#[cfg(feature = "dbc")]
use can_dbc::{AttributeValue, Dbc, MessageId};
use cosmic_core::time::Duration;
use std::path::Path;

#[cfg(feature = "dbc")]
/// The attribute in which DBC files state the period of a message, in milliseconds.
const CYCLE_TIME: &str = "GenMsgCycleTime";

#[cfg(feature = "dbc")]
/// The pseudo message in which DBC editors keep signals without a message.
const NO_MESSAGE: &str = "VECTOR__INDEPENDENT_SIG_MSG";

#[cfg(feature = "dbc")]
/// The messages of a DBC file. Those without a period get `default_period`.
///
/// # Errors
/// What is wrong and what would be right.
pub(super) fn read(path: &Path, default_period: Option<Duration>) -> Result<Vec<Foreign>, (String, String)> {
    let bytes = file::read(path).map_err(|error| {
        let help = "give the path of a DBC file, relative to the cluster file".to_owned();
        (format!("{} cannot be read: {error}", path.display()), help)
    })?;
    let text = file::decode(&bytes);
    let dbc = Dbc::try_from(text.as_str()).map_err(|error| {
        (format!("{} is no DBC file: {error}", path.display()), "repair or export it again".to_owned())
    })?;
    let messages = dbc.messages.iter().filter(|message| message.name != NO_MESSAGE);
    messages.map(|message| foreign(&dbc, message, default_period)).collect()
}

#[cfg(feature = "dbc")]
fn foreign(
    dbc: &Dbc,
    message: &can_dbc::Message,
    default_period: Option<Duration>,
) -> Result<Foreign, (String, String)> {
    let (id, extended) = match message.id {
        MessageId::Standard(id) => (u32::from(id), false),
        MessageId::Extended(id) => (id, true),
    };
    let period = match dbc.resolved_message_attribute(message.id, CYCLE_TIME) {
        Some(AttributeValue::Uint(ms)) if *ms > 0 => Some(Duration::from_millis(*ms)),
        Some(AttributeValue::Double(ms)) if *ms > 0.0 => Some(Duration::from_ticks((ms * 1e6) as u64)),
        _ => default_period,
    };
    let Some(period) = period else {
        let what = format!("message {} has no {CYCLE_TIME} attribute", message.name);
        return Err((what, "write period = \"...\" here for messages without one".to_owned()));
    };
    let length = u8::try_from(message.size).ok().filter(|length| *length <= 8).ok_or_else(|| {
        let what = format!("message {} has {} bytes", message.name, message.size);
        (what, "classic CAN frames have at most 8".to_owned())
    })?;
    let jitter = Duration::from_ticks(0);
    Ok(Foreign { name: message.name.clone(), id, extended, length, period, jitter, deadline: None })
}

#[cfg(not(feature = "dbc"))]
pub(super) fn read(path: &Path, _: Option<Duration>) -> Result<Vec<Foreign>, (String, String)> {
    let what = format!("{} cannot be read by this build of the planner", path.display());
    Err((what, "add the feature `dbc` to the dependency on cosmic-plan".to_owned()))
}
