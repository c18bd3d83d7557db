//! The suite itself: how an answer is judged, and that it goes on where it was stopped.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use twum_tests::suite::Case;
use twum_tests::suite::judge::Outcome;
use twum_tests::suite::runner::{Runner, read};
use twum_tests::suite::tables::{Count, markdown};
use twum_tests::truth::{Hidden, Kind, Truth};

fn outcome(kind: Kind, hidden: &[&str], answer: Value) -> Outcome {
    let effect = |name: &&str| Hidden {
        name: (*name).to_owned(),
        form: "some".to_owned(),
        size: 0.1,
        rho: 2.0,
        parameters: [("threshold_duty".to_owned(), 0.1)].into(),
        coordinate: name.starts_with("outside").then(|| "angle".to_owned()),
    };
    let truth = Truth {
        generator: "b".to_owned(),
        seed: 1,
        kind,
        effects: hidden.iter().map(effect).collect(),
        floor_rpm: [1.0; 2],
        effect_rpm: [2.0; 2],
        oracle_gain: [0.5; 2],
        motor: BTreeMap::new(),
        design: BTreeMap::new(),
    };
    Outcome { truth, answer, error: None, seconds: 1.0, clean_rmse_rpm: Some(1.0) }
}

fn said(verdict: &str, named: &[&str], ambiguous: &[&str]) -> Value {
    let entry = |status: &str, name: &&str| {
        let parameters = json!({"threshold_duty": {"value": 0.11, "ci95": [0.09, 0.12], "unit": "1"}});
        json!({"name": name, "status": status, "probability": 0.97, "parameters": parameters, "conflicts_with": []})
    };
    let mut effects: Vec<Value> = named.iter().map(|n| entry("named", n)).collect();
    effects.extend(ambiguous.iter().map(|n| entry("ambiguous", n)));
    json!({"verdict": verdict, "effects": effects,
        "baseline": {"rmse_speed_rpm": 2.0}, "extended": {"rmse_speed_rpm": 1.1}})
}

/// Fails if a right answer is called wrong or a wrong one right.
#[test]
fn answers_are_judged_by_what_was_hidden() {
    let judged = |kind, hidden: &[&str], answer| outcome(kind, hidden, answer).right();
    let one = ["dead-zone"];
    assert!(judged(Kind::Single, &one, said("named", &one, &[])));
    assert!(judged(Kind::Single, &one, said("ambiguous", &[], &["start-delay", "dead-zone"])));
    let four = ["start-delay", "dead-zone", "supply-sag", "clock-error"];
    assert!(!judged(Kind::Single, &one, said("ambiguous", &[], &four)), "a set of four is no answer");
    assert!(!judged(Kind::Single, &one, said("named", &["dead-zone", "clock-error"], &[])), "a wrong name beside it");
    assert!(!judged(Kind::Single, &one, said("none", &[], &[])));
    assert!(judged(Kind::Null, &[], said("none", &[], &[])));
    assert!(!judged(Kind::Null, &[], said("unknown", &[], &[])));
    assert!(judged(Kind::Outside, &["outside-cogging"], said("unknown", &[], &[])));
    assert!(judged(Kind::Removed, &one, said("unknown", &[], &[])));
    assert!(!judged(Kind::Removed, &one, said("named", &["clock-error"], &[])));
    let two = ["dead-zone", "clock-error"];
    assert!(judged(Kind::Pair, &two, said("named", &two, &[])));
    assert!(!judged(Kind::Pair, &two, said("named", &["clock-error"], &[])));
}

/// Fails if a description is taken for right whose strongest term hangs on something else.
#[test]
fn descriptions_are_judged_by_their_coordinate() {
    let described = |described: Value| {
        let mut answer = said("unknown", &[], &[]);
        answer["described"] = described;
        outcome(Kind::Outside, &["outside-cogging"], answer).described_rightly()
    };
    assert!(described(json!([{"coordinate": "angle"}, {"coordinate": "time"}])));
    assert!(!described(json!([{"coordinate": "time in the run"}, {"coordinate": "angle"}])));
    assert!(!described(Value::Null));
}

/// Fails if the tables count otherwise than the outcomes say.
#[test]
fn tables_count_what_the_outcomes_say() {
    let outcomes = [
        outcome(Kind::Null, &[], said("none", &[], &[])),
        outcome(Kind::Null, &[], said("named", &["clock-error"], &[])),
        outcome(Kind::Single, &["dead-zone"], said("named", &["dead-zone"], &[])),
    ];
    let text = markdown(&outcomes);
    for line in [
        "| nothing hidden: any name | 1/2 = 50 % (9–91) | ≤ 2 % |",
        "| nothing hidden: `none` | 1/2 = 50 % (9–91) | ≥ 95 % |",
        "| one effect, ρ ≥ 1: alone or in a set of at most 3 | 1/1 = 100 % (21–100) | ≥ 92 %, every effect ≥ 75 % |",
        "| 95 % intervals cover the hidden number | 1/1 = 100 % (21–100) | 90–98 % |",
        "| said probability 0.95–1.00: right | 1/2 = 50 % (9–91) | ≥ 93 % |",
        "| error removed over what an oracle removes, median of 1 | 90 % | ≥ 90 % |",
    ] {
        assert!(text.contains(line), "{line}\n{text}");
    }
    // Wilson's interval of 10 in 100, from the formula in closed form.
    let [low, high] = Count { hits: 10, of: 100 }.wilson();
    assert!((low - 0.0552).abs() < 1e-3 && (high - 0.1744).abs() < 1e-3, "{low} {high}");
}

/// Fails if the suite asks twice for what it has, loses a result when it is killed in the middle of a line, or is upset by a
/// command that fails.
#[cfg(unix)]
#[test]
fn a_stopped_suite_goes_on() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let twum = folder.path().join("twum");
    let calls = folder.path().join("calls");
    let script = format!("#!/bin/sh\necho called >> '{}'\necho '{}'\n", calls.display(), said("none", &[], &[]));
    std::fs::write(&twum, script).expect("the script can be written");
    std::fs::set_permissions(&twum, std::fs::Permissions::from_mode(0o755)).expect("it can be made a program");
    let out = folder.path().join("out");
    let runner = Runner { twum: twum.clone(), out: out.clone(), jobs: 2, twins: 0, shard: (1, 1) };
    let cases: Vec<Case> = (1..=3).map(|seed| Case { generator: "c".to_owned(), kind: Kind::Closed, seed }).collect();
    let times = || std::fs::read_to_string(&calls).map_or(0, |text| text.lines().count());
    runner.run(&cases[..2]).expect("it runs");
    assert_eq!(times(), 2);
    let results = out.join("results-1of1.jsonl");
    let text = std::fs::read_to_string(&results).expect("there are results");
    std::fs::write(&results, &text[..text.len() - 40]).expect("the last line can be cut");
    runner.run(&cases).expect("it runs again");
    assert_eq!(times(), 4, "the one that was cut off and the third");
    let outcomes = read(&[out]).expect("the results can be read");
    assert_eq!(outcomes.len(), 3);
    assert!(outcomes.iter().all(|o| o.verdict() == "none"));
    let left = std::fs::read_dir(folder.path().join("out")).expect("it is there").count();
    assert_eq!(left, 1, "data sets are taken away");

    std::fs::write(&twum, "#!/bin/sh\necho broken >&2\nexit 2\n").expect("the script can be written");
    let failing = Runner { out: folder.path().join("failed"), ..runner };
    failing.run(&cases[..1]).expect("a failing command is a result");
    let outcomes = read(&[failing.out]).expect("the results can be read");
    assert!(outcomes[0].error.as_ref().is_some_and(|e| e.contains("broken")) && !outcomes[0].right());
}
