//! The firmware at slower bit rates: the example's cluster with everything that takes longer then.

use std::fs;

use anyhow::{Context as _, Result};

use crate::demo;
use crate::tally::Tally;
use crate::workspace::Workspace;

/// Bit rates in kbit/s, besides the example's 1000.
const RATES: [u64; 4] = [50, 125, 250, 500];

/// Runs the demo at each of them; it judges itself.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    let example = workspace.root().join("cosmic-plan/examples/vehicle.toml");
    let example = fs::read_to_string(&example).with_context(|| format!("reading {}", example.display()))?;
    let folder = workspace.target_dir().join("bit-rates");
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    let mut tally = Tally::default();
    for rate in RATES {
        let cluster = folder.join(format!("vehicle-{rate}.toml"));
        fs::write(&cluster, slowed(&example, rate)?)
            .with_context(|| format!("writing {}", cluster.display()))?;
        let (cluster, out) = (cluster.display().to_string(), folder.display().to_string());
        let arguments = ["--cluster", &cluster, "--out", &out, "--seconds", "6", "--load", "60"];
        println!("==> the demo at {rate} kbit/s");
        let code = demo::run(workspace, &arguments.map(str::to_owned))?;
        tally.add(Ok(Tally::one(code == 0)));
    }
    Ok(tally)
}

/// The description for a bus of so many kbit/s: frames take longer, and so do the spans of all channels.
fn slowed(example: &str, rate: u64) -> Result<String> {
    let factor = 1000 / rate;
    let mut lines = Vec::new();
    for line in example.lines() {
        let (key, value) = line.split_once(" = ").unwrap_or((line, ""));
        lines.push(match key {
            "bit_rate" => format!("bit_rate = \"{rate} kbit/s\""),
            "period" | "deadline" | "validity" | "min_interarrival" | "phase" | "interval" => {
                let span = value.strip_prefix('"').and_then(|value| value.split_once(" ms\""));
                let (span, rest) = span.with_context(|| format!("`{line}` is no whole number of ms"))?;
                format!("{key} = \"{} ms\"{rest}", span.parse::<u64>()? * factor)
            }
            _ => line.to_owned(),
        });
    }
    Ok(lines.join("\n") + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_of_channels_grow_and_those_of_clocks_stay() {
        let example = "bit_rate = \"1 Mbit/s\"\nsync_period = \"25 ms\"\nperiod = \"10 ms\"  # one\n";
        let slow = "bit_rate = \"250 kbit/s\"\nsync_period = \"25 ms\"\nperiod = \"40 ms\"  # one\n";
        assert_eq!(slowed(example, 250).unwrap(), slow);
        assert!(slowed("deadline = \"1 s\"", 250).is_err());
    }
}
