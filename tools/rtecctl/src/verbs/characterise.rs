//! `rtecctl characterise …`: plan, record, import and evaluate runs.

mod evaluate;
mod import;
mod plan;
pub(crate) mod record;

use crate::prelude::*;
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Record};

/// The circle of a ballbar run, as options.
#[derive(Debug, clap::Args)]
pub(crate) struct BallbarCircleOptions {
    /// Ballbar: the bar's nominal length, mm
    #[arg(long, requires = "plane", value_name = "mm")]
    radius_mm: Option<f64>,
    /// Ballbar: its two axes, the angle running from the first towards the second, as x,y
    #[arg(long, requires = "radius_mm", value_name = "AXIS,AXIS")]
    plane: Option<String>,
}

impl BallbarCircleOptions {
    pub(crate) fn circle(&self) -> Result<Option<Circle>, InputError> {
        let (Some(radius_mm), Some(plane)) = (self.radius_mm, &self.plane) else { return Ok(None) };
        let axes: Option<Vec<Axis>> = plane.split(',').map(|n| Axis::new(n.trim())).collect();
        let wrong =
            || InputError::whole(Path::new("--plane"), format!("`{plane}`"), "two axes, as --plane x,y");
        let plane = axes.and_then(|a| a.try_into().ok()).ok_or_else(wrong)?;
        Ok(Some(Circle { radius_mm, plane, centre_mm: None }))
    }

    /// The record with the circle, if one was given.
    pub(crate) fn apply(&self, record: Record) -> Result<Record, InputError> {
        let Some(circle) = self.circle()? else { return Ok(record) };
        let options = Path::new("--radius-mm, --plane");
        record.with_circle(circle).map_err(|(found, expected)| InputError::whole(options, found, expected))
    }
}

super::verbs_below! {
    /// Plan, record, import and evaluate measurements of a machine
    Args;
    Evaluate evaluate::Args => evaluate::run;
    Import import::Args => import::run;
    Plan plan::Args => plan::run;
    Record record::Args => record::run;
}
