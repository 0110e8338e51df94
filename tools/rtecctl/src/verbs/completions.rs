//! `rtecctl completions SHELL`: shell completions on standard output.

use crate::prelude::*;
use clap_complete::Shell;

/// Print a completion script for your shell; it knows the names of the machine's axes
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The shell to complete in
    #[arg(required_unless_present = "axes")]
    shell: Option<Shell>,
    /// Print the names of the axes, one a line: the scripts ask for them
    #[arg(long, conflicts_with = "shell")]
    axes: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(shell) = args.shell {
        crate::say(&script(shell));
        return Ok(());
    }
    for name in DaemonArgs::at(None).axes() {
        println!("{name}");
    }
    Ok(())
}

/// The command that the scripts call.
const ASK: &str = "rtecctl completions --axes 2>/dev/null";

fn script(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut crate::help::command(), "rtecctl", &mut script);
    let mut script = String::from_utf8_lossy(&script).into_owned();
    let verbs = with_axis();
    match shell {
        Shell::Bash => {
            let words = verbs.join("|");
            let function = format!(
                "_rtecctl_axes() {{\n    local cur=\"${{COMP_WORDS[COMP_CWORD]}}\" prev=\"${{COMP_WORDS[COMP_CWORD-1]}}\"\n    \
                 case \"$prev\" in\n        {words}|--axis)\n            if [[ \"$cur\" != -* ]]; then\n                \
                 local IFS=$'\\n'\n                COMPREPLY=( $(compgen -W \"$({ASK})\" -- \"$cur\") )\n                \
                 return 0\n            fi\n            ;;\n    esac\n    _rtecctl \"$@\"\n}}\n\n"
            );
            script = script.replace("complete -F _rtecctl ", "complete -F _rtecctl_axes ");
            let at = script.find("\nif [[ \"${BASH_VERSINFO").map_or(script.len(), |at| at + 1);
            script.insert_str(at, &function);
        }
        Shell::Zsh => {
            let function = format!("_rtecctl_axes() {{\n    compadd -- ${{(f)\"$({ASK})\"}}\n}}\n\n");
            let lines = script.lines().map(|line| {
                let axis = line.contains(":AXIS:_default") || line.contains(":axis -- ");
                if axis { line.replace(":_default", ":_rtecctl_axes") } else { line.to_owned() }
            });
            script = lines.fold(String::new(), |all, line| all + &line + "\n");
            let at = script.find("\nif [ \"$funcstack[1]\"").map_or(script.len(), |at| at + 1);
            script.insert_str(at, &function);
        }
        Shell::Fish => {
            for verb in verbs {
                let _ = writeln!(
                    script,
                    "complete -c rtecctl -n \"__fish_seen_subcommand_from {verb}\" -f -a \"({ASK})\""
                );
            }
        }
        // The other shells complete only words of the script itself.
        _ => {}
    }
    script
}

/// The verbs whose first argument is an axis.
fn with_axis() -> Vec<String> {
    let command = crate::help::command();
    let takes_axis = |c: &clap::Command| c.get_positionals().next().is_some_and(|a| a.get_id() == "axis");
    command.get_subcommands().filter(|c| takes_axis(c)).map(|c| c.get_name().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_script_asks_for_the_axes_where_one_is_meant() {
        let verbs = with_axis();
        assert!(
            ["home", "correct", "explain"].iter().all(|verb| verbs.iter().any(|v| v == verb)),
            "{verbs:?}"
        );
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = script(shell);
            assert!(script.contains(ASK), "{shell}");
        }
        assert!(script(Shell::Zsh).matches(":_rtecctl_axes").count() > verbs.len());
    }

    /// As typed: `rtecctl home <Tab>`.
    #[test]
    fn bash_completes_the_name_of_an_axis() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::write(at("script"), script(Shell::Bash)).unwrap();
        // A stand-in for this program that lists the axes.
        std::fs::write(at("rtecctl"), "#!/bin/sh\nprintf 'x\\ny\\nzeta\\n'\n").unwrap();
        std::fs::set_permissions(at("rtecctl"), std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        let typed = |words: &str, n: u32| {
            let line = format!(
                "source script; COMP_WORDS=({words}); COMP_CWORD={n}; _rtecctl_axes rtecctl \"${{COMP_WORDS[{n}]}}\"; echo ${{COMPREPLY[@]}}"
            );
            let path = format!("{}:{}", directory.path().display(), std::env::var("PATH").unwrap());
            let mut run = std::process::Command::new("bash");
            let run =
                run.args(["-c", &line]).env("PATH", path).current_dir(directory.path()).output().unwrap();
            String::from_utf8(run.stdout).unwrap().trim().to_owned()
        };
        assert_eq!(typed("rtecctl home ''", 2), "x y zeta");
        assert_eq!(typed("rtecctl correct z", 2), "zeta");
        assert_eq!(typed("rtecctl log --axis ''", 3), "x y zeta");
        // All other words as before.
        assert_eq!(typed("rtecctl stat", 1), "status");
        assert!(typed("rtecctl home --js", 2).contains("--json"));
    }
}
