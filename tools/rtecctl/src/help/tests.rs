mod reference;

use super::*;

/// Verbs and their examples.
pub(crate) fn examples() -> impl Iterator<Item = (&'static str, &'static str)> {
    VERBS.iter().map(|v| (v.0, v.2))
}

/// Roles: name, description, verbs.
pub(crate) fn known() -> Vec<(&'static str, &'static str, Vec<&'static str>)> {
    let verbs = |n: usize| all().filter(|v| v.1 == n).map(|v| v.0).collect();
    ROLES.iter().enumerate().map(|(n, (role, who))| (*role, *who, verbs(n))).collect()
}

#[test]
fn every_verb_has_its_door_and_its_example_is_its_own() {
    let command = command();
    for verb in command.get_subcommands().map(Command::get_name) {
        assert_eq!(VERBS.iter().filter(|v| v.0 == verb).count(), usize::from(verb != "help"), "{verb}");
    }
    for (verb, _, example, _) in all() {
        assert!(example.starts_with(&format!("rtecctl {verb}")), "{verb}: {example}");
    }
    for example in all().map(|v| v.2).chain(BELOW) {
        let words = example.split(' ');
        if let Err(error) = super::command().try_get_matches_from(words)
            && error.exit_code() != 0
        {
            panic!("{example}: {error}");
        }
    }
}

#[test]
fn a_verb_that_is_none_is_answered_with_the_full_names_of_those_that_were_meant() {
    let said = |line: &str| {
        let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let error = super::command().try_get_matches_from(&words).unwrap_err();
        let said = with_meant(error, &words).render().to_string();
        said.lines().find_map(|l| l.trim().strip_prefix("tip: ").map(str::to_owned)).unwrap_or_default()
    };
    for (line, verbs) in [
        ("rtecctl evaluate x.run.toml", "'characterise evaluate'"),
        ("rtecctl fit", "'model fit'"),
        ("rtecctl import", "'characterise import'"),
        ("rtecctl plan", "'characterise plan'"),
        ("rtecctl errors", "'part errors'"),
        ("rtecctl evalaute", "'characterise evaluate'"),
        ("rtecctl recncile", "'reconcile'"),
        ("rtecctl statsu", "'status'"),
        ("rtecctl enabel", "'enable'"),
        ("rtecctl help evaluate", "'characterise evaluate'"),
        ("rtecctl model evaluate", "'characterise evaluate'"),
        ("rtecctl model vaildate", "'validate'"),
        ("rtecctl model status", "'status'"),
        ("rtecctl stable", "'part table'"),
        ("rtecctl nonsense", ""),
    ] {
        let tip = said(line);
        assert_eq!(tip.split_once(": ").map_or("", |(_, verbs)| verbs), verbs, "{line}: {tip}");
    }
    let export = said("rtecctl export");
    assert!(export.contains("'model export'") && export.contains("'ledger export'"), "{export}");
    // A verb below another one is never taken for `enable`.
    let mut all = Vec::new();
    paths(&Cli::command(), &mut Vec::new(), &mut all);
    for path in all.iter().filter(|p| p.len() > 1) {
        let word = path.last().unwrap();
        if !VERBS.iter().any(|v| v.0 == word) {
            let tip = said(&format!("rtecctl {word}"));
            assert!(!tip.contains("'enable'") && tip.contains(&path.join(" ")), "{word}: {tip}");
        }
    }
}

#[test]
fn a_usage_error_ends_with_an_example() {
    let next = |line: &str, said: &str| next(&line.split(' ').map(OsString::from).collect::<Vec<_>>(), said);
    assert_eq!(next("rtecctl simulate", "error: …"), "Example: rtecctl simulate --list\n");
    assert_eq!(
        next("rtecctl example", "error: …"),
        "Example: rtecctl example lathe lathe\nNames: rtecctl example --list\n"
    );
    let said = next("rtecctl model", "Example: rtecctl model show\n") + &next("rtecctl nonsense", "error: …");
    assert_eq!(said + &next("rtecctl", "error: …"), "");
    // Of a verb below another, its own example or none.
    let show = "Example: rtecctl model show --machine machine.toml\n";
    assert_eq!(["rtecctl model", "rtecctl model shwo", "rtecctl model show"].map(|l| next(l, "")), [show; 3]);
    let export = next("rtecctl model export --machine m.toml", "error: …");
    assert!(export.starts_with("Example: rtecctl model export --machine "), "{export}");
    assert_eq!(next("rtecctl model unload --now", "error: …"), "");
}

#[test]
fn where_to_begin_every_command_is_one() {
    for (_, line) in BEGIN {
        let asked = super::command().try_get_matches_from(line.split(' '));
        assert!(
            asked.as_ref().is_ok_and(|m| m.subcommand().is_some()) || line == "rtecctl help",
            "{line}: {asked:?}"
        );
    }
    assert!(begin().lines().all(|l| l.chars().count() <= 100), "{}", begin());
}

#[test]
fn the_list_of_verbs_is_as_recorded() {
    crate::golden("help.txt", &command().term_width(120).render_help().to_string());
}
