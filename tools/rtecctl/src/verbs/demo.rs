//! `rtecctl demo`: corrects a simulated axis with the embedded default.

/// Correct a simulated axis in real time: no hardware, no root, no configuration
///
/// The real engine runs on a thread of its own, against a mock card with a moving axis behind it and a controller that
/// counts what it is sent. The axis has an error of 240 µm per metre and a periodic one of its screw.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    options: rtec_demo::Options,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    rtec_demo::run(&args.options)
}
