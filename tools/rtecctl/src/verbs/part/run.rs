//! `rtecctl part run`: the whole process-intermittent loop, simulated.

use super::features::{read, write_drawn};
use super::points::positive;
use super::simulated_machine_args::SimMachineArgs;
use super::{failed, usage, write_all};
use crate::prelude::*;
use rtec_model::machine::Machine;
use rtec_part::contour::nose_of;
use rtec_part::contour_from_dxf::DxfOptions;
use rtec_sim::turning_experiment::TurningExperimentResult;

/// Go through all steps on the simulated machine: features, semi-finish, probe, errors, table, finish, inspect
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The part's half profile as DXF, whose nose is turned; else the report's, with --radius-mm
    drawing: Option<PathBuf>,
    #[command(flatten)]
    how: DxfOptions,
    #[command(flatten)]
    bench: SimMachineArgs,
    /// What is known of the machine: corrected live while cutting, off line in what was probed
    #[arg(long, value_name = "MACHINE.TOML")]
    model: Option<PathBuf>,
    /// Radius of the finished nose, in mm
    #[arg(long, default_value_t = 38.1, conflicts_with = "drawing")]
    radius_mm: f64,
    /// Semi-finish allowance on the radius, in mm
    #[arg(long, default_value_t = 0.254)]
    allowance_mm: f64,
    /// Probing points on the quadrant
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(5..=500))]
    points: u32,
    /// The largest error that the finish cut may leave, in µm; by default one correction
    #[arg(long)]
    limit_um: Option<f64>,
    /// Folder for the files of every step and report.html
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut setup = args.bench.setup()?;
    setup.radius_mm = positive("--radius-mm", args.radius_mm)?;
    setup.allowance_mm = positive("--allowance-mm", args.allowance_mm)?;
    if setup.allowance_mm > 5.0 {
        return Err(usage("--allowance-mm", setup.allowance_mm.to_string(), "at most 5 mm"));
    }
    setup.model = args.model.as_deref().map(Machine::read).transpose()?;
    setup.points = args.points as usize;
    let mut drawn = None;
    if args.drawing.is_none() && (args.how.unit.is_some() || args.how.layer.is_some()) {
        return Err(usage("DRAWING", "--units or --layer without it", "the drawing that they are about"));
    }
    if let Some(drawing) = &args.drawing {
        let (contour, _) = read(drawing, &args.how)?;
        (setup.centre, setup.radius_mm) = nose_of(&contour).ok_or_else(|| {
            let first = contour.features.first().map_or("nothing".into(), |f| format!("{:?}", f.kind));
            let expected = "a quarter of a circle about the axis at the free end, which the simulated lathe turns; other \
                            features go step by step: `rtecctl part points`, `probe`, `errors`";
            InputError::whole(drawing, format!("{first} as the first feature"), expected)
        })?;
        drawn = Some(contour);
    }
    let outcome = setup.run(&mut |step| eprintln!("{step} …")).map_err(failed)?;
    if let Some(folder) = &args.out {
        for (name, content) in &outcome.files {
            let (step, file) = name.rsplit_once('/').unwrap_or(("", name));
            write_all(&folder.join(step), &[(file, content)])?;
        }
        for (step, report) in &outcome.reports {
            write_all(&folder.join(step), &[("whisker.dxf", report.whisker_dxf())])?;
        }
        if let Some(contour) = &drawn {
            write_drawn(folder, contour)?;
        }
        write_all(folder, &[("decisions.log", outcome.decisions.join("\n") + "\n")])?;
    }
    answer(args.json, &outcome, || text(&outcome))?;
    ensure!(outcome.balanced(), No, "the ledger does not balance");
    let (left_um, limit_um) = (outcome.finish.largest_um, args.limit_um.unwrap_or(outcome.increment_um));
    if left_um > limit_um {
        fail!(No, "{left_um:.2} µm left, more than {limit_um:.2} µm");
    }
    Ok(())
}

fn text(o: &TurningExperimentResult) -> String {
    let mut t = format!("design {}, {:.0} µm a correction, seed {}\n\n", o.design, o.increment_um, o.seed);
    let _ = writeln!(t, "                          largest   bump     SD  SD after  true form  (µm)");
    let program = format!("finish, {} G01 lines", o.program_lines);
    for (name, r) in
        [("semi-finish", &o.semi_finish), ("finish, corrected", &o.finish), (program.as_str(), &o.program)]
    {
        let _ = writeln!(
            t,
            "{name:<24} {:>8.2} {:>6.2} {:>6.2} {:>9.2} {:>10.2}",
            r.largest_um, r.bump_um, r.sd_before_um, r.sd_after_um, r.true_form_um
        );
    }
    let ([z, x], most) = (o.insertions, o.corrections);
    let _ = writeln!(t, "\nat most {most} corrections; {z} insertions in Z, {x} in X; ledger balances");
    for p in &o.probing {
        let feed_m_min = p.feed_mm_min / 1e3;
        let _ = writeln!(
            t,
            "probing at {feed_m_min:>5.3} m/min: {:>6.1} s, capture within {:.2} µm ({:.2} RMS); 25 µs late costs {:.2} µm",
            p.seconds, p.capture_worst_um, p.capture_rms_um, p.late_25us_um
        );
    }
    t.push_str("\ndecisions:\n");
    for d in &o.decisions {
        let _ = writeln!(t, "- {d}");
    }
    t
}
