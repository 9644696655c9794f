//! Response times that were published.

use cosmic_plan::analysis::set::{Finding, MessageSet};
use cosmic_plan::document::Source;

fn analyse(text: &str) -> Vec<Finding> {
    let source = Source::new("set.toml", text);
    MessageSet::read(&source).unwrap_or_else(|problems| panic!("{problems}")).analyse(&|_| ()).messages
}

/// Davis, Burns, Bril, Lukkien 2007, table 2: the analysis of 1994 gives 3 ms for the third message, whose
/// second instance takes 3.5 ms and misses its deadline.
#[test]
fn three_messages_that_refute_the_analysis_of_1994() {
    let message = |name: &str, period: &str, deadline: &str| {
        format!(
            "[[message]]\nname = '{name}'\ntransmission_time = 1\nperiod = {period}\ndeadline = {deadline}\n"
        )
    };
    let set = [message("A", "2.5", "2.5"), message("B", "3.5", "3.25"), message("C", "3.5", "3.25")].concat();
    let found = analyse(&format!("bit_rate = 125_000\ntime_unit = 'ms'\n{set}"));
    let summary: Vec<_> = found.iter().map(|f| (f.exact_us, f.blocking_us, f.verdict)).collect();
    assert_eq!(
        summary,
        [(Some(2000.0), 1000.0, "meets"), (Some(3000.0), 1000.0, "meets"), (Some(3500.0), 0.0, "misses"),]
    );
    assert_eq!((found[2].instances, found[2].worst_instance), (2, 1));
    // The sufficient test finds the first two and rightly refuses the third.
    let sufficient: Vec<_> = found.iter().map(|f| f.sufficient_verdict).collect();
    assert_eq!(sufficient, ["meets", "meets", "unknown"]);
}

/// The SAE benchmark with piggybacked signals: bytes, jitter, period, deadline in ms, in the order of
/// priority (Tindell and Burns 1994).
const SAE: [(u8, f64, f64, f64); 17] = [
    (1, 0.1, 50.0, 5.0),
    (2, 0.1, 5.0, 5.0),
    (1, 0.1, 5.0, 5.0),
    (2, 0.1, 5.0, 5.0),
    (1, 0.1, 5.0, 5.0),
    (2, 0.1, 5.0, 5.0),
    (6, 0.2, 10.0, 10.0),
    (1, 0.2, 10.0, 10.0),
    (2, 0.2, 10.0, 10.0),
    (3, 0.2, 10.0, 10.0),
    (1, 0.2, 50.0, 20.0),
    (4, 0.3, 100.0, 100.0),
    (1, 0.3, 100.0, 100.0),
    (1, 0.2, 100.0, 100.0),
    (3, 0.4, 1000.0, 1000.0),
    (1, 0.3, 1000.0, 1000.0),
    (1, 0.3, 1000.0, 1000.0),
];

fn sae(transmission: impl Fn(u8) -> String) -> String {
    let message = |(bytes, jitter, period, deadline): &(u8, f64, f64, f64)| {
        let time = transmission(*bytes);
        format!("[[message]]\n{time}\njitter = {jitter}\nperiod = {period}\ndeadline = {deadline}\n")
    };
    let messages: String = SAE.iter().map(message).collect();
    // Below them any number of soft messages of 8 bytes.
    let soft = transmission(8);
    format!("bit_rate = 125_000\ntime_unit = 'ms'\n{messages}[[message]]\n{soft}\nperiod = 1000000\n")
}

/// The published numbers count `(34 + 8 s) / 5` stuff bits, which is one in every five, and leave the jitter
/// out.
#[test]
fn sae_benchmark_as_published() {
    let time_of_1994 = |bytes: u8| {
        let bits = (34 + 8 * u32::from(bytes)) / 5 + 47 + 8 * u32::from(bytes);
        format!("transmission_time = {:.3}", f64::from(bits) * 0.008)
    };
    let found = analyse(&sae(time_of_1994));
    let responses: Vec<f64> =
        found.iter().take(17).map(|f| f.exact_us.expect("there is a bound") - f.jitter_us).collect();
    println!("{responses:?}");
    assert_eq!(responses[..8], [1544.0, 2128.0, 2632.0, 3216.0, 3720.0, 4304.0, 5192.0, 8456.0]);
}
