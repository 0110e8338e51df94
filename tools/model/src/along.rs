//! A model along one axis: what a correction table of that axis holds, with everything else at rest at a stated place.

use crate::effect::Missing;
use crate::live::{AxisNow, Frame, Layout, Live};
use crate::machine::Machine;
use crate::record::Axis;

/// Where everything stands but the axis that the table is of.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Standing {
    /// Positions of the other axes, mm; those not listed are at zero.
    pub others_mm: Vec<(Axis, f64)>,
    /// Temperatures of the sensors, °C; those not listed are at 20 °C.
    pub degc: Vec<(String, f64)>,
}

impl Machine {
    /// The axes whose positions this model reads, beside `axis`: what a table of one axis must state the place of.
    #[must_use]
    pub fn other_axes(&self, axis: &Axis) -> Vec<Axis> {
        let mut axes: Vec<Axis> = Vec::new();
        let of_effects = self.effects().flat_map(|e| e.axes().iter().cloned());
        for a in of_effects.chain(self.chain().into_iter().flat_map(crate::chain::Chain::axes)) {
            if a != *axis && !axes.contains(&a) {
                axes.push(a);
            }
        }
        axes
    }

    /// Error of `axis` at these positions (mm), each approached in this direction (±1) and stood still at: effects and
    /// chain, µm, in the order of the positions. What depends on speed, time and load stays out.
    ///
    /// # Errors
    /// The model reads a channel: a table holds for none.
    pub fn along_um(
        &self,
        axis: &Axis,
        positions_mm: &[f64],
        direction: f64,
        standing: &Standing,
    ) -> Result<Vec<f64>, Missing> {
        let mut axes = vec![axis.clone()];
        axes.extend(self.other_axes(axis));
        let layout = Layout { axes: axes.clone(), sensors: self.sensors(), channels: Vec::new() };
        let find = |name: &String| standing.degc.iter().find(|(n, _)| n == name).map(|d| d.1);
        let degc: Vec<f64> =
            layout.sensors.iter().map(|n| find(n).unwrap_or(crate::effect::STANDARD_DEGC)).collect();
        let mut now: Vec<AxisNow> = axes
            .iter()
            .map(|a| {
                let place = standing.others_mm.iter().find(|(n, _)| n == a);
                AxisNow { position_mm: place.map_or(0.0, |p| p.1), ..AxisNow::default() }
            })
            .collect();
        let mut live = Live::of(self, layout)?;
        // In the order of travel: reversals are counted from the last one.
        let mut order: Vec<usize> = (0..positions_mm.len()).collect();
        order.sort_by(|a, b| (direction * positions_mm[*a]).total_cmp(&(direction * positions_mm[*b])));
        let mut errors = vec![0.0; positions_mm.len()];
        for n in order {
            now[0] = AxisNow { position_mm: positions_mm[n], direction, ..AxisNow::default() };
            live.evaluate(&Frame { axes: &now, temperatures_degc: &degc, ..Frame::default() });
            errors[n] = live.errors_um()[0];
        }
        Ok(errors)
    }
}
