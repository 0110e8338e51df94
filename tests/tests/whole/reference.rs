//! The guide's hand-written reference has what the code reads and writes.
//! `verbs.md` and `effects.md` are made from the code (`rtecctl`, `rtec-model`), and `rtec-toml.md` from the
//! configuration's tables of keys. `rtec-control` compares `protocol.md` with the code.

use rtec_control::protocol::word;
use rtec_measure::plausible::MistakeKind;
use rtec_model::record::{Axis, Role, RunKind};
use rtec_rt::link_messages::Fault;
use rtec_tests::daemon::program;
use rtec_tests::root;
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

fn page(name: &str) -> String {
    std::fs::read_to_string(root().join("tools/guide/reference").join(name)).unwrap()
}

fn source(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap()
}

/// The words that a page shows as code, in blocks and between backticks.
fn shown(page: &str) -> BTreeSet<String> {
    let mut words = BTreeSet::new();
    for (n, part) in page.split("```").enumerate() {
        let mut add = |code: &str| {
            words.extend(code.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').map(str::to_owned));
        };
        if n % 2 == 1 { add(part) } else { part.split('`').skip(1).step_by(2).for_each(add) }
    }
    words
}

/// Quoted words in the lists of keys that a reader knows.
/// Such a list is `….only(&["…", …])`, or the constant `KEYS` of its file.
fn keys_read(source: &str) -> Vec<&str> {
    let lists = source.split(".only(&[").skip(1);
    let named = source.split("const KEYS: [&str").skip(1).filter_map(|rest| Some(rest.split_once("= [")?.1));
    let lists = lists.chain(named).map(|rest| rest.split(']').next().unwrap());
    lists.flat_map(|list| list.split('"').skip(1).step_by(2)).collect()
}

/// The fields of a struct that is read from a file.
fn fields<'s>(source: &'s str, name: &str) -> Vec<&'s str> {
    let body = source.split(&format!("pub struct {name} {{\n")).nth(1).unwrap().split("\n}").next().unwrap();
    body.lines().filter_map(|l| l.trim().strip_prefix("pub ")?.split_once(':').map(|f| f.0)).collect()
}

#[track_caller]
fn all_stand(page_name: &str, words: &[&str], least: usize) {
    let shown = shown(&page(page_name));
    let missing: Vec<_> = words.iter().filter(|w| !shown.contains(**w)).collect();
    assert!(missing.is_empty(), "not in {page_name}: {missing:?}");
    assert!(words.len() >= least, "{words:?}");
}

#[test]
fn the_words_of_a_page_are_those_it_shows_as_code() {
    let shown = shown("plain `one` and `two.three`\n```toml\nfour = \"five\"\n```\nsix\n");
    for (word, is) in
        [("one", true), ("three", true), ("four", true), ("five", true), ("plain", false), ("six", false)]
    {
        assert_eq!(shown.contains(word), is, "{word}");
    }
    assert_eq!(
        keys_read("t.only(&[\"a\", \"b\"])?; u.only(&known); v.only(&[\n \"c\",\n])"),
        ["a", "b", "c"]
    );
    assert_eq!(
        fields("pub struct S {\n    /// x\n    pub a: u8,\n    pub b_mm: f64,\n}\npub c: u8", "S"),
        ["a", "b_mm"]
    );
}

#[test]
fn keys_of_the_files_stand_on_their_pages() {
    for (page, file, least) in [
        ("machine-toml.md", "tools/model/src/machine/read_machine_toml.rs", 20),
        ("machine-toml.md", "tools/model/src/effect/laws_from_file.rs", 12),
        ("chain.md", "tools/model/src/kinematic_chain.rs", 15),
        ("records.md", "tools/records/src/run_record_files.rs", 11),
        ("records.md", "tools/measure/src/import/user_format.rs", 8),
        ("records.md", "tools/measure/src/compensation_export/user_format.rs", 13),
        ("records.md", "tools/measure/src/iso230/conditions.rs", 2),
    ] {
        all_stand(page, &keys_read(&source(file)), least);
    }
    let own = source("tools/model/src/effect/laws_from_file.rs");
    let quantities = own.split("const QUANTITIES").nth(1).unwrap().split("];").next().unwrap();
    all_stand(
        "machine-toml.md",
        &quantities.split("(\"").skip(1).map(|q| q.split('"').next().unwrap()).collect::<Vec<_>>(),
        13,
    );
    all_stand("part-files.md", &fields(&source("tools/part/src/probing_program.rs"), "Dialect"), 13);
    all_stand("part-files.md", &fields(&source("tools/sim/src/lathe.rs"), "LatheSpec"), 13);
    all_stand("part-files.md", &rtec_part::probing_program::PARAMETERS.map(|p| p.name), 22);
}

#[test]
fn kinds_and_roles_stand_among_the_records() {
    all_stand("records.md", &RunKind::ALL.map(|k| k.0), 8);
    let text = page("records.md");
    let code = source("tools/model/src/role.rs");
    let body = code.split("pub enum Role {").nth(1).unwrap().split("\n}").next().unwrap();
    let roles: Vec<_> = body.lines().map(str::trim).filter(|l| l.starts_with(char::is_uppercase)).collect();
    assert_eq!(roles.len(), 15, "{roles:?}");
    for role in roles {
        // TimeOfDay(Axis) → time_of_day.A
        let name = role.split(['(', ',']).next().unwrap();
        let snake = name.char_indices().fold(String::new(), |word, (n, c)| {
            word + if n > 0 && c.is_uppercase() { "_" } else { "" } + &c.to_lowercase().to_string()
        });
        let axes = ["", ".A", ".A.b"][role.matches("Axis").count()];
        let row = text.lines().find(|l| l.starts_with(&format!("| `{snake}{axes}` |")));
        let row = row.unwrap_or_else(|| panic!("no row of `{snake}{axes}`"));
        let parsed = Role::parse(&format!("{snake}{}", axes.replace('A', "x"))).unwrap();
        if let Some(unit) = parsed.unit() {
            assert!(row.split('|').nth(2).unwrap().contains(unit), "{row}");
        }
        assert_eq!(parsed.axis().is_some(), axes == ".A", "{row}");
    }
    assert_eq!(Axis::new("x").unwrap().as_str(), "x");
}

#[test]
fn every_field_of_a_verdict_stands_on_its_page() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = |words: &[&str]| Command::new(program("rtecctl")).current_dir(at).args(words).output().unwrap();
    assert!(run(&["example", "lathe", "l"]).status.success());
    let linear = "l/records/linear-displacement-z.run.toml";
    let said = run(&[
        "reconcile",
        linear,
        "--model",
        "l/machine.toml",
        "--holdout",
        "l/holdout/linear-displacement-z.run.toml",
        "--json",
    ]);
    let verdict: Value = serde_json::from_slice(&said.stdout).unwrap();
    let mut keys = BTreeSet::new();
    collect(&verdict, &mut keys);
    // Parameters belong to the effects, and so do the keys that tell sensors apart.
    let effects = source("tools/guide/reference/effects.md");
    // So do the keys of a set-up's records; its terms end with the response.
    let keys: Vec<&str> = keys
        .iter()
        .filter(|k| !effects.contains(&format!("| `{k}` |")) && !k.ends_with(".run.toml"))
        .map(|k| k.split('.').next().unwrap_or(k))
        .collect();
    all_stand("verdict.md", &keys, 25);
    all_stand("verdict.md", &MistakeKind::ALL.map(|kind| kind.0), 11);
    all_stand("verdict.md", &["named", "nothing_missing", "unknown_effect", "not_separable"], 4);
}

fn collect(value: &Value, keys: &mut BTreeSet<String>) {
    match value {
        Value::Object(map) => {
            for (key, inner) in map {
                keys.insert(key.clone());
                collect(inner, keys);
            }
        }
        Value::Array(all) => all.iter().for_each(|inner| collect(inner, keys)),
        _ => {}
    }
}

#[test]
fn every_field_of_a_replay_stands_among_the_traces() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.csv"), "t_ns,a,b\n0,0,0\n100000,1,0\n200000,1,1\n").unwrap();
    std::fs::write(folder.path().join("r.csv"), "t_ns,requested\n0,2\n").unwrap();
    let words = ["replay", "--trace", "t.csv", "--requests", "r.csv", "--json"];
    let said = Command::new(program("rtecctl")).current_dir(&folder).args(words).output().unwrap();
    let document: Value = serde_json::from_slice(&said.stdout).unwrap();
    let keys: Vec<&str> = document.as_object().unwrap().keys().map(String::as_str).collect();
    all_stand("traces.md", &keys, 11);
    all_stand("traces.md", &["t_ns", "a", "b", "requested"], 4);
}

#[test]
fn every_family_of_metrics_stands_on_its_page() {
    let code = source("tools/control/src/metrics.rs");
    let code = code.split("#[cfg(test)]").next().unwrap();
    let names: Vec<&str> = code.split('"').skip(1).step_by(2).filter(|t| t.starts_with("rtec_")).collect();
    all_stand("metrics.md", &names, 30);
}

/// The string literals of a source, joined over line ends, without backticks.
/// Comments are left out.
fn literals(source: &str) -> Vec<String> {
    let lines = source.lines().filter(|l| !l.trim_start().starts_with("//"));
    let code = lines.collect::<Vec<_>>().join("\n").replace("\\\"", "”");
    let inside = code.split('"').skip(1).step_by(2);
    inside
        .map(|text| {
            let joined = text.split("\\\n").map(str::trim_start).collect::<String>();
            joined.replace('`', "").replace('”', "\"")
        })
        .collect()
}

/// The parts of a text between its figures and names.
/// In the table these are `…`.
fn parts(text: &str) -> impl Iterator<Item = &str> {
    text.split(['…', ':']).map(|p| p.trim_matches([' ', ';', ',', '.'])).filter(|p| p.len() > 5)
}

/// The operator's table of alarms has every text of the daemon, and no other.
#[test]
fn the_table_of_alarms_is_what_the_code_can_say() {
    let page = source("tools/guide/operator/alarms.md");
    let section =
        |name: &str| page.split(&format!("\n## {name}")).nth(1).unwrap().split("\n## ").next().unwrap();
    // The first cells of a section's rows, as code.
    let first_cells = |name: &str| -> Vec<String> {
        let rows = section(name).lines().filter_map(|l| l.strip_prefix("| `"));
        let cells = rows.map(|row| format!("`{}", row.split(" | ").next().unwrap()));
        cells.flat_map(|c| c.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>()).collect()
    };
    let faults: BTreeSet<String> = first_cells("Faults").into_iter().collect();
    assert_eq!(faults, Fault::ALL.map(word).into(), "faults of the table and of the code");

    let all = |files: &[&str]| files.iter().flat_map(|f| literals(&source(f))).collect::<Vec<_>>();
    let words = source("tools/control/src/protocol/explanations.rs");
    let refusals =
        words.split("fn explain_refusal").nth(1).unwrap().split("fn explain_fault").next().unwrap();
    let session = ["rt_requests", "model_and_table_loads", "status_reports"]
        .map(|f| format!("tools/rtecd/src/control_side/{f}.rs"));
    let mut said = all(&session.each_ref().map(String::as_str));
    said.extend(literals(refusals));
    // Texts that are no refusal and no alarm: parts of others, logs, and malformed requests.
    let other = [
        "{",
        "machine model",
        "part table ",
        "no machine model",
        "found ",
        "a restart ",
        "rtecctl model validate it",
        "there is no such axis",
        "although expired",
        "axis {}: total",
        "axis {unknown}: {}",
        "feed hold by {by}",
        "feed hold by {} stays",
        "since the ",
        "axis {}",
        "no model is loaded: {why}",
        "the model {file}",
    ];
    let rows: Vec<String> =
        ["Reasons *not correcting*", "Sensors", "Refusals"].iter().flat_map(|s| first_cells(s)).collect();
    let in_table = |text: &str| {
        rows.iter().any(|row| {
            let mut parts = parts(row).peekable();
            parts.peek().is_some() && parts.all(|p| text.contains(p))
        })
    };
    let lacking: Vec<&String> = (said.iter())
        .filter(|text| text.contains(' ') && text.len() > 15 && !other.iter().any(|o| text.starts_with(o)))
        .filter(|text| !in_table(text))
        .collect();
    assert!(lacking.is_empty(), "not in the table of alarms: {lacking:#?}");

    said.extend(all(&[
        "tools/control/src/config/rt_latency_figures.rs",
        "tools/sensors/src/sensor_bank.rs",
        "tools/sensors/src/sensor_text_stream.rs",
        "tools/rtecd/src/request_file_loader.rs",
        "tools/rtecd/src/control_socket_server.rs",
        "tools/correct/src/corrector.rs",
        "tools/correct/src/part_table.rs",
        "tools/sensors/src/sensor_monitor.rs",
        "tools/correct/src/model_evaluator.rs",
        "tools/correct/src/correction_total.rs",
        "tools/model/src/machine/warnings_before_use.rs",
    ]));
    // A row may name what fills a text's gap ("feed hold by user …"). Then the row has the text before the gap.
    let before_gap = |text: &String| text.split_once('{').map(|(head, _)| head.trim().to_owned());
    let heads: Vec<String> = said.iter().filter_map(before_gap).filter(|head| head.len() >= 12).collect();
    let says = |row: &String| {
        parts(row).all(|p| said.iter().any(|text| text.contains(p)))
            || heads.iter().any(|head| row.contains(head.as_str()))
    };
    let never: Vec<&String> = rows.iter().filter(|row| !says(row)).collect();
    assert!(never.is_empty(), "in the table of alarms, but never said: {never:#?}");
}
