//! The channels of the demo.

use cosmic_core::Subject;

/// Temperatures of the vehicle.
pub const TEMPERATURE: Subject = Subject::new(0xC05A_1C00_0000_0002).unwrap();
/// The etag of commands; those of pings and pongs come next.
pub const COMMAND_ETAG: u16 = 9000;
/// Of commands, pings and pongs.
pub const SUBJECTS: [Subject; 3] = [
    Subject::new(0xC05A_1C00_0000_00C0).unwrap(),
    Subject::new(0xC05A_1C00_0000_00C1).unwrap(),
    Subject::new(0xC05A_1C00_0000_00C2).unwrap(),
];
/// The etag of the gateways' beacons.
pub const GATEWAYS_ETAG: u16 = 9010;

/// What may cross: events of the vehicle, and those of the demo. Wheel speeds are hard real-time, and do not.
pub const CHANNELS: &str = r#"
[[channel]]
name = "temperature"
subject = "0xC05A1C0000000002"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "20 ms"
burst = 3
unasked = ["east"]
from = ["west"]
[[channel]]
name = "brake_force"
subject = "0xC05A1C0000000003"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "10 ms"
burst = 3
unasked = ["east"]
from = ["west"]
[[channel]]
name = "command"
subject = "0xC05A1C00000000C0"
class = "soft"
deadline = "100 ms"
validity = "300 ms"
interval = "5 ms"
burst = 20
longest-wait = "5 ms"
[[channel]]
name = "ping"
subject = "0xC05A1C00000000C1"
class = "soft"
deadline = "500 ms"
validity = "1 s"
interval = "1 ms"
burst = 20
longest-wait = "5 ms"
[[channel]]
name = "pong"
subject = "0xC05A1C00000000C2"
class = "soft"
deadline = "500 ms"
validity = "1 s"
interval = "1 ms"
burst = 20
longest-wait = "5 ms"
"#;
