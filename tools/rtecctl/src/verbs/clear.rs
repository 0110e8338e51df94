//! `rtecctl clear`: release latched faults.

use crate::daemon_connection::{NO_EVENTS, ask, observe};
use crate::prelude::*;
use rtec_control::protocol::{ClientRequest, DaemonStatus, word};

/// Release latched faults, once their cause is mended; says which they were and what must be homed again
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.daemon.json {
        return args.daemon.order(&ClientRequest::Clear {}, "");
    }
    let mut client = args.daemon.connect()?;
    let before = observe(&mut client, NO_EVENTS)?.status;
    ask(&mut client, &ClientRequest::Clear {})?;
    let after = observe(&mut client, NO_EVENTS)?.status;
    print!("{}", released(&before, &after));
    Ok(())
}

fn released(before: &DaemonStatus, after: &DaemonStatus) -> String {
    let latched = |s: &DaemonStatus| {
        let machine = s.faults.iter().map(word);
        let axes =
            s.axes.iter().flat_map(|a| a.faults.iter().map(|f| format!("axis {}: {}", a.name, word(f))));
        machine.chain(axes).collect::<Vec<_>>()
    };
    let (was, still) = (latched(before), latched(after));
    let mut text = match list(was.iter().filter(|f| !still.contains(f))).as_str() {
        "" => "nothing was latched\n".to_owned(),
        gone => format!("released: {gone}\n"),
    };
    for fault in &still {
        let _ = writeln!(text, "latched again: {fault}");
    }
    for (known, how) in
        [(true, "`rtecctl home`"), (false, "the controller too, then `rtecctl home --controller-homed`")]
    {
        let home = list(after.axes.iter().filter(|a| !a.homed && a.mtc_known == known).map(|a| &a.name));
        if !home.is_empty() {
            let _ = writeln!(text, "to be homed again: {home} ({how})");
        }
    }
    if let Some(hold) = after.hold.as_ref().filter(|_| after.mode == "hold") {
        let _ = writeln!(text, "feed hold by {} stays: `rtecctl hold off`", hold.by);
    }
    if after.mode == "disabled" || after.mode == "hold" && !after.enabled {
        text += "corrections are off: `rtecctl enable`\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::protocol::FeedHoldReport;
    use rtec_rt::link_messages::Fault;

    #[test]
    fn what_was_released_and_what_is_to_be_done() {
        let after: DaemonStatus =
            serde_json::from_str(include_str!("../../tests/golden/status.json")).unwrap();
        let mut before = after.clone();
        assert_eq!(released(&before, &after), "nothing was latched\n");
        before.axes[0].faults = vec![Fault::PollGap];
        before.faults = vec![Fault::Card];
        let mut after = after;
        after.mode = "disabled".into();
        (after.axes[0].homed, after.axes[0].mtc_known) = (false, true);
        let name = &after.axes[0].name;
        let wanted = format!(
            "released: card, axis {name}: poll_gap\nto be homed again: {name} (`rtecctl home`)\ncorrections are off: \
             `rtecctl enable`\n"
        );
        assert_eq!(released(&before, &after), wanted);
        after.axes[0].mtc_known = false;
        let text = released(&before, &after);
        assert!(text.contains("the controller too, then `rtecctl home --controller-homed`"), "{text}");
        after.mode = "hold".into();
        (after.enabled, after.hold) = (false, Some(FeedHoldReport { by: "user root".into(), at_s: None }));
        let text = released(&before, &after);
        let ends =
            "feed hold by user root stays: `rtecctl hold off`\ncorrections are off: `rtecctl enable`\n";
        assert!(text.ends_with(ends), "{text}");
        after.faults = vec![Fault::Card];
        assert!(released(&before, &after).contains("latched again: card\n"));
    }
}
