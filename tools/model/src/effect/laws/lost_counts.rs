//! `lost_counts.A`: a step at one moment that stays.

use crate::effect::{
    EffectInputColumns, LawDescription, Effect, RecordExtent, ThermalDependence, Input, Law, RequiredInput, Out, LawParameter, SearchGridPoint,
    ParameterRefinement, ParameterFitMethod, EffectMemory,
};
use std::sync::Arc;

#[derive(Debug)]
struct LostCounts(LawDescription);

const UM: usize = 0;
const AT: usize = 1;

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(LostCounts(LawDescription {
        name: "lost_counts".into(),
        law: "e = um from at_s on; whole counts".into(),
        cause: "edges lost or gained by a decoder, a connector, a scale that is dirty".into(),
        parameters: vec![
            LawParameter::linear("um", "um", 10_000.0).typically(6.0)
                .within([-1e6, 1e6], "a metre: a decoder that lost so much has lost the axis"),
            LawParameter::new("at_s", "s", [0.0, 1e6], ParameterFitMethod::Chosen)
                .within([-1e12, 1e12], "30 000 years: no clock of a log is that far off")
                .refined(ParameterRefinement::Moment)
                .telling_apart(),
        ],
        needs: vec![RequiredInput::Time],
        experiment: "return to a fixed stop or to the reference mark before and after".into(),
        heat: ThermalDependence::StandsIn,
        whole_counts: true,
        ..LawDescription::default()
    }))
}

impl Law for LostCounts {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out[0] = f64::from(now.t_s >= effect.scalar(AT));
    }

    fn basis_rows(&self, effect: &Effect, bound: &EffectInputColumns<'_>, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let at_s = effect.scalar(AT);
        for (row, out) in out.iter_mut().enumerate() {
            *out = f64::from(bound.t_s[row] >= at_s);
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut EffectMemory, out: Out<'_>) {
        self.basis(effect, now, component, state, &mut out[UM..=UM]);
    }

    /// About 160 moments; the search continues between them from row to row.
    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let all = records.moments_s();
        let price = (all.len().max(2) as f64).ln();
        let step = (all.len() / 160).max(1);
        SearchGridPoint::along(effect, AT, all.into_iter().step_by(step), price)
    }
}
