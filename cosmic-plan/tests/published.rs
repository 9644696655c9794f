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
    // From the ninth on: the same equations by hand.
    let expected = [
        1544.0, 2128.0, 2632.0, 3216.0, 3720.0, 4304.0, 5192.0, 8456.0, 9040.0, 9696.0, 10200.0, 19088.0,
        19592.0, 20096.0, 28904.0, 29408.0, 29912.0,
    ];
    assert_eq!(responses, expected);
    assert!(found.iter().take(17).all(|f| f.verdict == "meets"));
}

/// With the frame lengths of 2007, jitter included: by hand as far as no second instance comes in, and one
/// further.
#[test]
fn sae_benchmark_with_real_frame_lengths() {
    let found = analyse(&sae(|bytes| format!("length = {bytes}")));
    let responses: Vec<f64> = found.iter().take(8).map(|f| f.exact_us.expect("there is a bound")).collect();
    let blocking = 1080.0;
    let (one, two, six) = (520.0, 600.0, 920.0);
    let mut sum = blocking;
    let mut expected = Vec::new();
    for time in [one, two, one, two, one, two] {
        sum += time;
        expected.push(sum + 100.0);
    }
    sum += six;
    expected.push(sum + 200.0);
    // By then the five messages of 5 ms have come again.
    expected.push(sum + 3.0 * two + 2.0 * one + one + 200.0);
    assert_eq!(responses, expected);
}

/// Faults: each costs 31 bit times and the longest frame of the level.
#[test]
fn both_error_models_against_hand_calculation() {
    let message = |id: u32, length: u8, period: u32| {
        format!("[[message]]\nid = {id}\nlength = {length}\nperiod = '{period} ms'\n")
    };
    let set = [message(1, 8, 10), message(2, 0, 20), message(0x100_0000, 8, 100)].concat();
    let exact = |errors: &str| -> Vec<f64> {
        analyse(&format!("bit_rate = 1_000_000\n{errors}\n{set}")).iter().filter_map(|f| f.exact_us).collect()
    };
    // Standard frames of 135 and 55 bits, an extended one of 160.
    assert_eq!(exact(""), [160.0 + 135.0, 160.0 + 135.0 + 55.0, 135.0 + 55.0 + 160.0]);
    let (level_1, level_3) = (31.0 + 135.0, 31.0 + 160.0);
    let burst = exact("[errors]\nburst = 2\ninterval = '50 ms'");
    assert_eq!(burst, [295.0 + 2.0 * level_1, 350.0 + 2.0 * level_1, 350.0 + 2.0 * level_3]);
    let window = exact("[errors]\ncount = 3\nwindow = '5 ms'");
    assert_eq!(window, [295.0 + 3.0 * level_1, 350.0 + 3.0 * level_1, 350.0 + 3.0 * level_3]);
    // One every 300 µs on top: the third message sees two more until it has been sent.
    let dense = exact("[errors]\nburst = 1\ninterval = '300 us'");
    let mut response = 350.0_f64;
    while response != 350.0 + (response / 300.0).ceil() * level_3 {
        response = 350.0 + (response / 300.0).ceil() * level_3;
    }
    assert_eq!(dense[2], response);
}

/// Jitter, arbitrary deadlines, overload.
#[test]
fn messages_without_a_bound_say_so() {
    let found = analyse(
        "bit_rate = 125_000\n[[message]]\ntransmission_time = '1 ms'\nperiod = '1.5 ms'\n\
         [[message]]\ntransmission_time = '1 ms'\nperiod = '2 ms'\n",
    );
    let summary: Vec<_> = found.iter().map(|f| (f.exact_us, f.verdict)).collect();
    assert_eq!(summary, [(Some(2000.0), "misses"), (None, "misses")]);
}

#[test]
fn json_says_the_same_as_toml() {
    let toml = analyse(
        "bit_rate = 125_000\ntime_unit = 'ms'\n[errors]\nburst = 1\ninterval = 50\n\
         [[message]]\nname = 'a'\nid = 0x10\nlength = 8\nperiod = 12.5\njitter = 0.1\n\
         [[message]]\nname = 'b'\nid = 0x18000010\nlength = 3\nperiod = 20\ndeadline = 30\n",
    );
    let json = analyse(
        r#"{ "bit_rate": "125 kbit/s", "errors": { "burst": 1, "interval": "50 ms" }, "messages": [
            { "name": "a", "id": 16, "length": 8, "period": "12.5 ms", "jitter": "100 us" },
            { "name": "b", "id": "0x18000010", "extended": true, "length": 3, "period": "20 ms",
              "deadline": "30 ms" } ] }"#,
    );
    assert_eq!(toml, json);
    // Beyond the period the sufficient test says nothing.
    assert_eq!((json[1].sufficient_us, json[1].sufficient_verdict), (None, "unknown"));
    assert!(json[1].exact_us.is_some());
}
