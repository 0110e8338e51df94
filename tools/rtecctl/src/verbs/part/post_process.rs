//! `rtecctl part post-process`: systematic errors of a batch of measured parts.
//! Changes are offered, not applied.

use super::{usage, within, write_all};
use crate::prelude::*;
use rtec_files::text_file::short;
use rtec_part::batch_evaluation::{
    BatchEvaluation, OutlierReading, PlaceFinding, PlaceStatistics, SignificanceLimits, evaluate_columns,
};
use rtec_part::error_cor_file::{error_cor, read_arc};

/// Judge a batch measured off the machine and offer changes
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Measurements: a CSV `part,feature,error_um[,angle_rad]`, or with `nominal_mm,measured_mm` for the error
    #[arg(long)]
    batch: PathBuf,
    /// Columns of the file that have other names, or none, each by its name or number from 1; all others are left out
    #[arg(long, value_name = "NAME=COLUMN", value_delimiter = ',')]
    columns: Vec<String>,
    /// What probing on the machine found on the same feature: an `error.cor`
    #[arg(long, value_name = "ERROR.COR")]
    inspected: Option<PathBuf>,
    #[command(flatten)]
    limits: SignificanceLimits,
    /// Write offer.cor (errors to add to the table's, should you decide so) into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let SignificanceLimits { alpha, least_um } = args.limits;
    if !(alpha > 0.0 && alpha < 1.0) {
        return Err(usage("--alpha", alpha.to_string(), "a rate between 0 and 1"));
    }
    within("--least-um", least_um, 0.0..=f64::MAX, "0 or more, in µm")?;
    let seen = args.inspected.as_deref().map(read_arc).transpose()?;
    let batch = evaluate_columns(&args.batch, &args.columns, seen.as_deref(), args.limits)?;
    if let Some(written) = &batch.written {
        eprintln!("note: {written}");
    }
    let file = args.batch.display();
    if let Some(step) = batch.step_um {
        let step = short(1e-6 * (1e6 * step).round());
        eprintln!(
            "warning: the errors are in steps of {step} µm, and the parts scatter by little more or less: what rounding may do is in the \
             intervals, and no mean below half a step is systematic"
        );
    }
    if batch.places.iter().any(|p| p.interval_um.is_none()) {
        eprintln!(
            "warning: {file}: every reading is 0: the step that they are read in does not show, so the means have no interval. Half a step \
             of the gauge may be hidden: read with a finer one"
        );
    }
    for PlaceStatistics { feature, angle_rad, mean_um, sd_um, left_out, with_every_reading, .. } in
        &batch.places
    {
        if let (false, Some(with)) = (left_out.is_empty(), with_every_reading) {
            let reading =
                |w: &OutlierReading| format!("part {}, {} µm (line {})", w.part, short(w.error_um), w.line);
            let readings = list(left_out.iter().map(reading));
            let at = angle_rad.map_or_else(String::new, |a| format!(" at {a:.4} rad"));
            eprintln!(
                "warning: {file}: {feature}{at}: far off the other parts, and in no figure: {readings}. With every reading the mean would be \
                 {:.2} instead of {mean_um:.2} µm, the SD {:.2} instead of {sd_um:.2} µm. Put the reading right, or measure that part again",
                with.mean_um, with.sd_um
            );
        }
    }
    let unseen = batch.places.iter().filter(|p| p.seen_on_machine_um.is_none()).count();
    if seen.is_some() && unseen > 0 {
        eprintln!(
            "rtecctl: {unseen} of {} places have no inspected point within 0.05 rad: judged as without an inspection",
            batch.places.len()
        );
    }
    if let Some(folder) = &args.out {
        let offered = &batch.offer_table;
        if let Some(other) = offered.iter().find(|o| o.feature != offered[0].feature) {
            let found = format!("changes of {} and of {}", offered[0].feature, other.feature);
            return Err(usage("--out", found, "one feature: offer.cor is one table; a batch file for each"));
        }
        let errors: Vec<_> = offered.iter().map(|o| o.error).collect();
        write_all(folder, &[("offer.cor", error_cor(&errors))])?;
    }
    answer(args.json, &batch, || text(&batch))
}

fn text(batch: &BatchEvaluation) -> String {
    let mut t =
        "feature         angle rad  parts  mean µm    SD µm        p   trend µm        p\n".to_owned();
    for p in &batch.places {
        let angle = p.angle_rad.map_or("-".to_owned(), |a| format!("{a:.4}"));
        let mark = match p.finding {
            PlaceFinding::Nothing => "",
            PlaceFinding::Systematic => "  systematic",
            PlaceFinding::NotObservable => "  systematic, not observable on the machine",
            PlaceFinding::Trend => "  trend",
            PlaceFinding::Step => "  step",
        };
        let _ = writeln!(
            t,
            "{:<15} {angle:>9} {:>6} {:>8.2} {:>8.2} {:>8.4} {:>10.3} {:>8.4}{mark}",
            p.feature, p.parts, p.mean_um, p.sd_um, p.p_value, p.trend_um_per_part, p.trend_p_value
        );
    }
    t.push_str(if batch.offers.is_empty() { "\nnothing to change\n" } else { "\noffered, not applied:\n" });
    for offer in &batch.offers {
        let _ = writeln!(t, "- {offer}");
    }
    t
}
