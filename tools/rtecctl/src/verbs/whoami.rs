//! `rtecctl whoami`: as whom the daemon knows this user, and the requests allowed.

use crate::daemon_connection::DaemonArgs;
use rtec_control::protocol::{ClientProcess, ClientRequest, DaemonResponse};

/// Show as whom the daemon knows you, and what you may ask for
///
/// The role is that of the socket by which you reach it: its group and mode stand in `[control]` of the configuration.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if let DaemonResponse::Whoami(caller) = args.daemon.ask(&ClientRequest::Whoami {})?
        && !args.daemon.json
    {
        print!("{}", text(&caller));
    }
    Ok(())
}

fn text(caller: &ClientProcess) -> String {
    let ClientProcess { uid, user, pid, exe, role, may, socket } = caller;
    let role = role.replace('_', " ");
    format!("user {user} ({uid}), process {pid} {exe}\nrole {role}, by {socket}\nmay {}\n", may.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_by_what_and_what_for() {
        let caller = ClientProcess {
            uid: 1000,
            user: "anna".into(),
            pid: 42,
            exe: "/usr/bin/rtecctl".into(),
            role: "set_up".into(),
            may: vec!["status".into(), "correct".into()],
            socket: "/run/rtec/control.sock".into(),
        };
        let wants = "user anna (1000), process 42 /usr/bin/rtecctl\nrole set up, by /run/rtec/control.sock\nmay status, correct\n";
        assert_eq!(text(&caller), wants);
    }
}
