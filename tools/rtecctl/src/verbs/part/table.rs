//! `rtecctl part table`: the finish cut's corrections by position.

use super::points::positive;
use super::{usage, within, write_all};
use crate::prelude::*;
use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, AxisCountConversion, FinishCutArc, csv};
use rtec_part::error_cor_file::FeatureErrors;
use rtec_part::geometric_fit::Zx;
use rtec_part::straight_finish_cut_table::StraightFinishCutTable;

/// Turn part errors into the table of corrections for the finish cut
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Errors as `part errors` writes them: by angle of an arc, by place of a straight feature
    #[arg(long, value_name = "ERROR.COR")]
    errors: PathBuf,
    #[command(flatten)]
    cut: FinishCutArgs,
    #[command(flatten)]
    counts: ScaleCountArgs,
    /// Entries interpolated between each two probed points
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u16).range(0..=1000))]
    between: u16,
    /// Feed of the finish cut, in mm/min
    #[arg(long, default_value_t = 100.0)]
    feed_mm_min: f64,
    /// Send each correction this long before the tool is there, in ms
    #[arg(long, default_value_t = 50.0)]
    lead_ms: f64,
    /// The cut runs towards smaller angles
    #[arg(long)]
    backwards: bool,
    /// Write the same compensation as G01 moves too, within this of the path, in µm
    #[arg(long, value_name = "OFF_UM")]
    g01_um: Option<f64>,
    /// Folder for table.csv and g01.nc
    #[arg(long)]
    out: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// The arc of the finish cut
#[allow(clippy::struct_field_names, reason = "units belong in names")]
#[derive(Debug, clap::Args)]
pub(crate) struct FinishCutArgs {
    /// Centre of the arc on the part's axis, in mm of part coordinates; a straight feature's errors bring their places
    #[arg(long, allow_negative_numbers = true)]
    centre_z_mm: Option<f64>,
    /// Distance of the arc's centre from the part's axis, in mm
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    centre_x_mm: f64,
    /// Radius of the finished surface, in mm; not for a straight feature
    #[arg(long)]
    radius_mm: Option<f64>,
    /// Radius of the tool's nose, in mm
    #[arg(long, default_value_t = 0.0)]
    nose_mm: f64,
    /// The arc is hollow, a fillet or a groove: the nose's centre runs inside it
    #[arg(long)]
    pub(crate) hollow: bool,
    /// Machine Z at which the nose's centre is at the part's origin: work offset and tool length, in mm
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    tool_z_mm: f64,
    /// The same for X
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    tool_x_mm: f64,
}

impl FinishCutArgs {
    pub(crate) fn cut(&self) -> anyhow::Result<FinishCutArc> {
        let given = |name: &str, value: Option<f64>| {
            let expected = "a number in mm: the errors are those of an arc, by angle";
            value.ok_or_else(|| usage(name, "nothing", expected))
        };
        let radius_mm = positive("--radius-mm", given("--radius-mm", self.radius_mm)?)?;
        let radius_mm = place("--radius-mm", radius_mm)?;
        let centre_z_mm = place("--centre-z-mm", given("--centre-z-mm", self.centre_z_mm)?)?;
        let (nose_mm, origin) = self.tool()?;
        let centre = Zx::new(centre_z_mm, place("--centre-x-mm", self.centre_x_mm)?);
        if self.hollow && nose_mm >= radius_mm {
            let expected = format!("a nose that fits into the arc, below {radius_mm} mm");
            return Err(usage("--nose-mm", nose_mm.to_string(), expected));
        }
        let nose_mm = if self.hollow { -nose_mm } else { nose_mm };
        Ok(FinishCutArc { centre, radius_mm, nose_mm, origin })
    }

    /// Refuses options of an arc together with the errors of a straight feature.
    pub(crate) fn is_of_no_arc(&self) -> anyhow::Result<()> {
        if self.hollow {
            return Err(usage("--hollow", "errors of a straight feature", "those of an arc"));
        }
        if self.radius_mm.is_some() || self.centre_z_mm.is_some() {
            let expected = "neither: a straight feature's errors bring their places";
            return Err(usage("--radius-mm, --centre-z-mm", "an arc's place", expected));
        }
        Ok(())
    }

    /// Radius of the tool's nose, and position of the part's origin, mm.
    /// The position is the machine's when the nose's centre is at the origin.
    pub(crate) fn tool(&self) -> anyhow::Result<(f64, Zx)> {
        within("--nose-mm", self.nose_mm, 0.0..=1000.0, "a radius in mm, 0 to 1000")?;
        let (z, x) = (place("--tool-z-mm", self.tool_z_mm)?, place("--tool-x-mm", self.tool_x_mm)?);
        Ok((self.nose_mm, Zx::new(z, x)))
    }
}

/// Limit of every position, mm; no machine is longer.
const FARTHEST_MM: f64 = 100_000.0;

fn place(name: &str, value: f64) -> anyhow::Result<f64> {
    within(name, value, -FARTHEST_MM..=FARTHEST_MM, "a place in mm, within 100 m of zero")
}

/// The corrector's counts
#[derive(Debug, clap::Args)]
pub(crate) struct ScaleCountArgs {
    /// What one count is worth, in µm
    #[arg(long, default_value_t = 1.0)]
    count_um: f64,
    /// Counts of one insertion: 2 for Design C, 4 for the Original and Design A, 1 for Design B
    #[arg(long, default_value_t = 2, value_parser = increment)]
    increment: i64,
    /// Z counts down towards the part's +Z
    #[arg(long)]
    z_counts_down: bool,
    /// X counts down away from the part's axis
    #[arg(long)]
    x_counts_down: bool,
}

fn increment(text: &str) -> Result<i64, String> {
    text.parse().ok().filter(|n| [1, 2, 4].contains(n)).ok_or_else(|| "expected 1, 2 or 4".to_owned())
}

impl ScaleCountArgs {
    pub(crate) fn axes(&self) -> anyhow::Result<[AxisCountConversion; 2]> {
        let count_um = self.count_um;
        within("--count-um", count_um, 1e-4..=1000.0, "what a scale's count is worth: 0.0001 to 1000 µm")?;
        Ok([self.z_counts_down, self.x_counts_down].map(|down| AxisCountConversion {
            count_um,
            increment: self.increment,
            sign: if down { -1.0 } else { 1.0 },
        }))
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let axes = args.counts.axes()?;
    let (nose_mm, origin) = args.cut.tool()?;
    let feed_mm_s = positive("--feed-mm-min", args.feed_mm_min)? / 60.0;
    let lead_ms = within("--lead-ms", args.lead_ms, 0.0..=f64::MAX, "a time in ms, 0 or more")?;
    let lead_mm = feed_mm_s * lead_ms * 1e-3;
    let off_mm = args.g01_um.map(|um| positive("--g01-um", um)).transpose()?.map(|um| um * 1e-3);
    let (rows, text, moves) = match FeatureErrors::read(&args.errors)? {
        FeatureErrors::Line(errors) => {
            args.cut.is_of_no_arc()?;
            let table = StraightFinishCutTable { errors, axes, nose_mm, origin };
            let rows = table.rows(usize::from(args.between));
            let text = table.csv(&rows, lead_mm, args.backwards);
            (rows, text, off_mm.map(|_| table.straight_moves()))
        }
        FeatureErrors::Arc(errors) => {
            let table = ArcFinishCutTable::new(args.cut.cut()?, axes, errors);
            let rows = table.rows(usize::from(args.between));
            let text = csv(&table, &rows, lead_mm, args.backwards);
            (rows, text, off_mm.map(|off_mm| table.straight_moves(off_mm, 4)))
        }
    };
    let moves = moves.unwrap_or_default();
    let mut made = vec![("table.csv", text)];
    if !moves.is_empty() {
        made.push(("g01.nc", g01(&moves, args.feed_mm_min)));
    }
    write_all(&args.out, &made)?;
    let [z, x] = [0, 1].map(|axis| rows.iter().map(|r| r.requested[axis].abs()).max().unwrap_or(0));
    let left_um = rows.iter().map(|r| r.left_um.abs()).fold(0.0, f64::max);
    let lines = moves.len().saturating_sub(1);
    let document = serde_json::json!({"rows": rows, "lead_mm": lead_mm, "most_requested": [z, x],
        "most_left_um": left_um, "g01_lines": lines});
    answer(args.json, &document, || {
        let same = format!("the same as {lines} G01 lines in g01.nc\n");
        format!(
            "{} entries, at most {z} counts in Z and {x} in X, at most {left_um:.2} µm left along the normal\n\
             sent {lead_mm:.3} mm ahead\n{}",
            rows.len(),
            if lines > 0 { &same } else { "" }
        )
    })
}

/// Straight moves of the nose's centre in part coordinates, mm, X a radius.
fn g01(moves: &[Zx], feed_mm_min: f64) -> String {
    let line = |(i, p): (usize, &Zx)| {
        let feed = if i == 0 { format!(" F{feed_mm_min}") } else { String::new() };
        format!("G01 Z{:.4} X{:.4}{feed}\n", p.z, p.x)
    };
    moves.iter().enumerate().map(line).collect()
}
