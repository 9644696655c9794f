//! The picture of the calendar: what is in it for clusters with many slots, and of the classes that have none.

use cosmic_plan::analysis::segment::assess;
use cosmic_plan::cluster::Cluster;
use cosmic_plan::document::Source;
use cosmic_plan::output::svg;
use cosmic_plan::plan::{Effort, plan};
use std::fmt::Write as _;

/// The picture of a cluster with so many hard channels, and what `more` says of others.
fn picture(hard: usize, more: &str, names: &[&str]) -> String {
    let mut text = String::from(
        "[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nstamp_latency = '1 us'\n\
         release_jitter = '5 us'\n[[node]]\nname = 'a'\nuid = 1\npublishes = [",
    );
    (0..hard).for_each(|at| write!(text, "'position_{at}', ").unwrap());
    names.iter().for_each(|name| write!(text, "'{name}', ").unwrap());
    text += "]\n";
    for at in 0..hard {
        let number = at + 1;
        writeln!(
            text,
            "[[channel]]\nname = 'position_{at}'\nsubject = {number}\nclass = 'HRT'\nlength = 8\n\
             period = '100 ms'\nomission_degree = 0"
        )
        .unwrap();
    }
    text += more;
    let cluster = Cluster::read(&Source::new("a.toml", text)).unwrap_or_else(|problems| panic!("{problems}"));
    let plan = plan(&cluster, &Effort::default()).expect("it fits");
    svg::render(&cluster, &plan, &assess(&cluster, &plan))
}

#[test]
fn every_channel_of_many_has_its_name() {
    let picture = picture(120, "", &[]);
    for at in 0..120 {
        assert!(picture.contains(&format!("position_{at} (a)")), "{at}");
    }
    // Beyond that a lane is for a node.
    assert!(!self::picture(151, "", &[]).contains(">\nposition_0 (a)"));
}

#[test]
fn bounds_are_bars_and_loads_go_through_the_cycle() {
    let more = "[[channel]]\nname = 'heat'\nsubject = 1000\nclass = 'SRT'\nlength = 8\nperiod = '10 ms'\n\
                deadline = '5 ms'\n[[channel]]\nname = 'haste'\nsubject = 1001\nclass = 'SRT'\nlength = 8\n\
                period = '10 ms'\ndeadline = '200 us'\n[[channel]]\nname = 'diary'\nsubject = 1002\n\
                class = 'NRT'\nlength = 40\nmin_interarrival = '1 s'\n";
    let names = ["heat", "haste", "diary"];
    let picture = picture(3, more, &names);
    // One that holds, one that does not, one without a deadline.
    for class in ["class=\"bound\"", "class=\"late\"", "class=\"deadline\"", "class=\"others\""] {
        assert!(picture.contains(class), "{class}");
    }
    for words in ["heat (a)", "haste (a)", "diary (a)", " of 5 ms", "no deadline", "Load over the cycle: "] {
        assert!(picture.contains(words), "{words}");
    }
    assert!(picture.contains("class=\"frame\"") && picture.contains("class=\"provision\""));
}
