//! What descriptions are refused for, and how it is said: one mistake is one problem, with its place and remedy.

use cosmic_plan::analysis::advice::advice;
use cosmic_plan::analysis::proof::{Origin, Verdict};
use cosmic_plan::analysis::segment::assess;
use cosmic_plan::analysis::set::MessageSet;
use cosmic_plan::cluster::Cluster;
use cosmic_plan::document::{Problems, Source};
use cosmic_plan::plan::relax::relaxations;
use cosmic_plan::plan::{Effort, NoPlan, plan};
use std::fmt::Write as _;

/// A cluster of one node that publishes `c`, with these lines in the segment and these of the channel.
fn text(segment: &str, channel: &str) -> String {
    format!(
        "[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nrelease_jitter = '5 us'\n{segment}\n\
         [[node]]\nname = 'a'\nuid = 1\npublishes = ['c']\n[[channel]]\nname = 'c'\n{channel}\n"
    )
}

const SEGMENT: &str = "clock_accuracy = '50 us'";

fn refused(text: &str) -> Problems {
    Cluster::read(&Source::new("a.toml", text)).expect_err(text)
}

/// The only problem: its field and its help.
fn only(problems: &Problems) -> (String, String) {
    assert_eq!(problems.list().len(), 1, "{problems}");
    (problems.list()[0].field.clone(), problems.list()[0].help.clone())
}

#[test]
fn a_malformed_field_is_not_missing_as_well() {
    let soft = "subject = 1\nclass = 'SRT'\nlength = 2\nperiod = '5 ms'\ndeadline = '5 ms'\n";
    for (field, wrong) in [
        ("period", soft.replace("period = '5 ms'", "period = '-5 ms'")),
        ("deadline", soft.replace("deadline = '5 ms'", "deadline = 5")),
        ("length", soft.replace("length = 2", "length = 'two'")),
        ("subject", soft.replace("subject = 1", "subject = 'one'")),
        ("class", soft.replace("'SRT'", "'SOFT'")),
    ] {
        assert_eq!(only(&refused(&text(SEGMENT, &wrong))).0, format!("channel.c.{field}"));
    }
    // A period that is not known is not shorter than a deadline or a phase either.
    let hard = "subject = 1\nclass = 'HRT'\nlength = 2\nperiod = 5\ndeadline = '7 s'\nphase = '6 s'";
    assert_eq!(only(&refused(&text(SEGMENT, hard))).0, "channel.c.period");
    let errors = format!("{}\n[errors]\nburst = -1\ninterval = '5 ms'", text(SEGMENT, soft));
    assert_eq!(only(&refused(&errors)).0, "errors.burst");
    let foreign = format!("{}\n[[foreign]]\nid = 1000\nlength = 'x'\nperiod = '5 ms'", text(SEGMENT, soft));
    assert_eq!(only(&refused(&foreign)).0, "foreign[0].length");
    let nodes = text(SEGMENT, soft).replace("[[node]]\nname = 'a'\nuid = 1\npublishes = ['c']\n", "");
    let nodes = refused(&format!("node = 3\n{nodes}"));
    assert!(!nodes.to_string().contains("node: is missing"), "{nodes}");
    for set in ["period = -3", "period = 'soon'"] {
        let set = format!("bit_rate = 125000\ntime_unit = 'ms'\n[[message]]\nlength = 8\n{set}\n");
        let problems = MessageSet::read(&Source::new("a.toml", set)).expect_err("it is wrong");
        assert_eq!(only(&problems).0, "message.message 0.period");
    }
    let set = "bit_rate = 125000\n[[message]]\nlength = 'x'\nperiod = '5 ms'\n";
    let problems = MessageSet::read(&Source::new("a.toml", set)).expect_err("it is wrong");
    assert_eq!(only(&problems).0, "message.message 0.length");
}

#[test]
fn keys_of_json_stand_once() {
    let set =
        "{\"bit_rate\": 125000, \"message\": [{\"length\": 8, \"period\": \"5 ms\", \"period\": \"9 ms\"}]}";
    let problems = MessageSet::read(&Source::new("a.json", set)).expect_err("it is ambiguous");
    assert_eq!(only(&problems), ("period".to_owned(), "keep one of the two".to_owned()));
    assert_eq!(problems.list()[0].place, Some(65..73));
}

#[test]
fn json_of_other_programs_is_read() {
    let set = "{\"bit_rate\": 1.25e5, \"time_unit\": \"ms\", \"message\": [\
               {\"length\": 8, \"period\": 1e1, \"deadline\": 0.30000000000000004e1, \"jitter\": 2.5E-1}]}";
    let set = MessageSet::read(&Source::new("a.json", set)).unwrap_or_else(|problems| panic!("{problems}"));
    let finding = &set.analyse(&|_| ()).messages[0];
    assert_eq!((finding.period_us, finding.deadline_us, finding.jitter_us), (10_000.0, 3_000.0, 250.0));
    let negative =
        "{\"bit_rate\": 125000, \"time_unit\": \"ms\", \"message\": [{\"length\": 8, \"period\": -1e1}]}";
    let problems = MessageSet::read(&Source::new("a.json", negative)).expect_err("it is negative");
    assert!(only(&problems).1.starts_with("write a number from 0"), "{problems}");
    let fine = "bit_rate = 125000\n[[message]]\nlength = 8\nperiod = '1.00000000005 s'\n";
    let problems = MessageSet::read(&Source::new("a.toml", fine)).expect_err("it is too fine");
    assert_eq!(only(&problems).1, "round it to whole nanoseconds");
}

#[test]
fn reserved_subjects_and_impossible_clocks_are_refused() {
    let channel = "class = 'NRT'\nlength = 2\nperiod = '5 ms'\n";
    let (field, help) = only(&refused(&text(SEGMENT, &format!("subject = '0xFFFFFFFFFFFFFFFF'\n{channel}"))));
    assert_eq!((&*field, &*help), ("channel.c.subject", "choose another subject"));
    let channel = format!("subject = 1\n{channel}");
    for (clock, holds) in [
        ("clock_accuracy = '10 us'", false),
        ("clock_accuracy = '12 us'", true),
        ("clock_accuracy = '2 us'\nstamp_latency = '2 us'", false),
        ("clock_accuracy = '3 us'\nstamp_latency = '1 us'", true),
        ("clock_accuracy = '2 us'\nsync_period = '0 s'", true),
    ] {
        let text = text(clock, &channel);
        match Cluster::read(&Source::new("a.toml", &*text)) {
            Ok(_) => assert!(holds, "{clock}"),
            Err(problems) => {
                assert!(!holds, "{problems}");
                assert_eq!(only(&problems).0, "segment.clock_accuracy");
            }
        }
    }
}

#[test]
fn a_long_line_is_not_shown_and_not_quoted() {
    let long = "x".repeat(10_000_000);
    let wrong = text(SEGMENT, &format!("subject = 1\nclass = 'NRT'\nlength = 2\nperiod = '{long}'"));
    let problems = refused(&wrong);
    assert_eq!(only(&problems).0, "channel.c.period");
    assert!(problems.to_string().len() < 2_000 && problems.render(false).len() < 2_000);
    let shown = problems.render(false).replace("\n  │ ", " ");
    assert!(shown.contains("(line 15, column 10)"), "{shown}");
}

#[test]
fn many_mistakes_are_counted() {
    let mut text = String::from("[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nrelease_jitter = '5 us'\n");
    text += "clock_accuracy = '50 us'\n[[node]]\nname = 'a'\nuid = 1\npublishes = [";
    (0..10_000).for_each(|at| write!(text, "'channel_number_{at}_x', ").unwrap());
    text += "]\n";
    for at in 0..10_000 {
        write!(
            text,
            "[[channel]]\nname = 'channel_number_{at}'\nsubject = {}\nclass = 'HRT'\nlength = 8\nperiod = '10 ms'\n",
            at + 1
        )
        .unwrap();
    }
    let problems = refused(&text);
    // No such channel, no publisher, and no etag for the most.
    assert!(problems.list().len() > 20_000);
    let shown = problems.render(false);
    assert!(shown.ends_with("more like these\n") && shown.len() < 100_000);
    assert!(problems.to_string().ends_with("more like these\n"));
    assert_eq!(problems.to_json().as_array().map(Vec::len), Some(problems.list().len()));
}

#[test]
fn a_hard_event_is_delivered_in_its_own_period() {
    // Two windows fill 2 ms nearly: neither may reach beyond its end.
    let channel = "subject = 1\nclass = 'HRT'\nlength = 8\nperiod = '2 ms'\nomission_degree = 4";
    let cluster = Cluster::read(&Source::new("a.toml", text(SEGMENT, channel))).expect("it is well formed");
    let plan = plan(&cluster, &Effort::default()).expect("it fits");
    let assessment = assess(&cluster, &plan);
    let proof = &assessment.channels[0].proof;
    let slot = &plan.slots()[0];
    assert_eq!(proof.origin, Origin::Period);
    assert_eq!(proof.bound, Some(slot.slot.phase + slot.times.delivery));
    assert!(proof.bound <= proof.deadline && proof.deadline == Some(slot.slot.period));
    assert_eq!(proof.from_ready, Some(slot.times.delivery));
    assert_eq!(
        proof.terms.iter().map(|term| term.span.as_ticks()).sum::<u64>(),
        proof.bound.unwrap().as_ticks()
    );
}

#[test]
fn a_sporadic_hard_event_waits_for_its_slot() {
    let channel = "subject = 1\nclass = 'HRT'\nlength = 8\nmin_interarrival = '10 ms'\nomission_degree = 1";
    let judged = |deadline: &str| {
        let text = text(SEGMENT, &format!("{channel}\n{deadline}"));
        let cluster =
            Cluster::read(&Source::new("a.toml", text)).unwrap_or_else(|problems| panic!("{problems}"));
        let plan = plan(&cluster, &Effort::default()).expect("it fits");
        cosmic_plan::verify::verify(&cluster, &plan).expect("it is right");
        let window = plan.slots()[0].times.delivery.as_ticks();
        let proof = assess(&cluster, &plan).channels.remove(0).proof;
        assert_eq!(proof.origin, Origin::Publication);
        // At worst the slot has just been ready: the next one, its window, and clocks that differ by 2 x 50 us.
        assert_eq!(proof.bound.unwrap().as_ticks(), 10_000_000 + window + 100_000);
        assert_eq!(proof.terms.iter().map(|term| term.span.as_ticks()).sum::<u64>(), 10_100_000 + window);
        proof.verdict
    };
    assert_eq!(judged(""), Verdict::NoDeadline);
    assert_eq!(judged("deadline = '10 ms'"), Verdict::Misses);
    assert_eq!(judged("deadline = '11 ms'"), Verdict::Meets);
}

/// A cluster of hard channels: period in microseconds and omission degree.
fn hard(channels: &[(u64, u8)]) -> Cluster {
    let names: Vec<String> = (0..channels.len()).map(|at| format!("'c{at}'")).collect();
    let mut text = format!(
        "[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '50 us'\nrelease_jitter = '20 us'\n\
         [[node]]\nname = 'a'\nuid = 1\npublishes = [{}]\n",
        names.join(", ")
    );
    for (at, (period, degree)) in channels.iter().enumerate() {
        write!(
            text,
            "[[channel]]\nname = 'c{at}'\nsubject = {}\nclass = 'HRT'\nlength = 8\nperiod = '{period} us'\n\
             omission_degree = {degree}\n",
            at + 1
        )
        .unwrap();
    }
    Cluster::read(&Source::new("a.toml", text)).unwrap_or_else(|problems| panic!("{problems}"))
}

#[test]
fn one_budget_of_steps_is_for_all() {
    // 21 % more than all of the time, in 900 channels: the sum says so.
    let full = hard(&(0..900).map(|at| ([500_000, 1_000_000][at % 2], 2)).collect::<Vec<_>>());
    let effort = Effort::of(10_000_000);
    let Err(NoPlan::Impossible(conflict)) = plan(&full, &effort) else { panic!("it is full") };
    assert_eq!(conflict.reason, "the windows need more than all of the time");
    relaxations(&full, &conflict, &effort);
    // A set that takes a search: how far it goes depends on the steps, not on the machine.
    let tight = hard(&(0..6).map(|at| ([6_000, 10_000, 14_000][at % 3], 2)).collect::<Vec<_>>());
    let outcome = |steps: u64| {
        let effort = Effort::of(steps);
        let outcome = plan(&tight, &effort).map_err(|failure| format!("{failure:?}"));
        (outcome, effort.left())
    };
    assert_eq!(outcome(300_000_000), outcome(300_000_000));
    assert!(outcome(300_000_000).0.is_err_and(|failure| failure.starts_with("Impossible")));
    let (few, left) = outcome(1_000);
    assert!(few.is_err_and(|failure| failure.starts_with("GaveUp")) && left < 1_000);
}

#[test]
fn gaps_are_even_where_they_can_be() {
    // Windows of 682 us: two every 10 ms and two every 20 ms stand in every half of 20 ms, three and three at best.
    let cluster = hard(&[(10_000, 1), (10_000, 1), (20_000, 1), (20_000, 1)]);
    let plan = plan(&cluster, &Effort::default()).expect("it fits");
    cosmic_plan::verify::verify(&cluster, &plan).expect("it is right");
    let window = plan.slots()[0].times.delivery.as_ticks();
    let best = (10_000_000 - 3 * window) / 3;
    let gap = plan.narrowest_gap().as_ticks();
    assert!(gap <= best && gap * 10 >= best * 9, "{gap} of {best}");
}

#[test]
fn a_soft_channel_without_a_proof_gets_advice_that_helps() {
    let soft = |period: &str, deadline: &str| {
        let channel =
            format!("subject = 1\nclass = 'SRT'\nlength = 8\nperiod = '{period}'\ndeadline = '{deadline}'");
        let text = text(SEGMENT, &channel);
        Cluster::read(&Source::new("a.toml", text)).unwrap_or_else(|problems| panic!("{problems}"))
    };
    let short = soft("5 ms", "400 us");
    let plan_of = |cluster: &Cluster| plan(cluster, &Effort::default()).expect("it fits");
    let assessment = assess(&short, &plan_of(&short));
    assert!(!assessment.holds());
    let advised = advice(&short, &assessment, &Effort::default());
    let longer =
        advised[0].change.strip_prefix("c: a deadline of ").and_then(|rest| rest.split(" instead").next());
    let longer = soft("5 ms", longer.expect("it is the cheapest change"));
    assert!(assess(&longer, &plan_of(&longer)).holds());
    // More than the bus can carry: no deadline helps.
    let much = soft("100 us", "2 ms");
    let advised = advice(&much, &assess(&much, &plan_of(&much)), &Effort::default());
    assert!(advised.iter().all(|change| !change.change.contains("deadline")));
    assert!(advised[0].change.starts_with("c: a period of "), "{advised:?}");
    // A sporadic hard event waits for its slot; slots more often make the wait shorter.
    let sporadic = "subject = 1\nclass = 'HRT'\nlength = 8\nmin_interarrival = '10 ms'\ndeadline = '6 ms'";
    let sporadic = Cluster::read(&Source::new("a.toml", text(SEGMENT, sporadic))).expect("it is well formed");
    let advised = advice(&sporadic, &assess(&sporadic, &plan_of(&sporadic)), &Effort::default());
    let changes: Vec<&str> = advised.iter().map(|change| &*change.change).collect();
    assert!(changes[0].starts_with("c: a deadline of 11 ms instead of 6 ms"), "{changes:?}");
    assert!(changes[1].starts_with("c: a min_interarrival of 5.2 ms instead of 10 ms"), "{changes:?}");
}

#[test]
fn a_node_that_asks_for_its_id_needs_a_broker_and_no_slot() {
    let soft = "subject = 1\nclass = 'SRT'\nlength = 2\nperiod = '5 ms'\ndeadline = '5 ms'\n";
    let hard = "subject = 1\nclass = 'HRT'\nlength = 2\nperiod = '5 ms'\nomission_degree = 1\n";
    let asks = |segment: &str, channel: &str, id: &str| {
        text(&format!("{SEGMENT}\n{segment}"), channel)
            .replace("uid = 1\n", &format!("uid = 1\ntx_node = {id}\n"))
    };
    let broker = "binding = 'broker'";
    let cluster = Cluster::read(&Source::new("a.toml", asks(broker, soft, "'ask'"))).unwrap();
    assert!(cluster.nodes[0].asks);
    for (text, help) in [
        (asks("", soft, "'ask'"), "write binding = \"broker\" in [segment], or a number, or leave it out"),
        (
            asks(broker, hard, "'ask'"),
            "write a number, or leave it out, or let another node publish that channel",
        ),
        (
            asks("sealed = true", soft, "'ask'"),
            "write a number, or leave it out: in a sealed cluster each node is known by its id",
        ),
        (asks(broker, soft, "'asks'"), "write a number from 0 to 126, or \"ask\""),
        (asks(broker, soft, "300"), "write a number from 0 to 126, or \"ask\""),
        (asks(broker, soft, "127"), "write a number from 0 to 126 that no other node has"),
    ] {
        assert_eq!(only(&refused(&text)), ("node.a.tx_node".to_owned(), help.to_owned()), "{text}");
    }
    // Two that ask do not have one id.
    let other = "[[node]]\nname = 'b'\nuid = 2\ntx_node = 'ask'\n[[channel]]";
    let two = asks(broker, soft, "'ask'").replace("[[channel]]", other);
    assert!(Cluster::read(&Source::new("a.toml", two)).is_ok());
}
