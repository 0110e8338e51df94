//! An effect over a record, with its columns looked up once.
//! Basis values, sums and slopes are computed column by column.

use super::temperature_difference::ResolvedTemperatureDifference;
use super::{Effect, EffectMemory, EffectNameAxes, Input, Out, RequiredInput, sign};
use crate::record::{Record, Role};
use rtec_files::InputError;

/// A sensor or channel that an effect names and a record does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no {what}, which effect {effect} reads (the record has: {has})")]
pub struct MissingInput {
    /// The effect that reads it.
    pub effect: String,
    /// What is missing, as `temperature.T8` or `channel.z9`.
    pub what: String,
    /// The names of that role that the record has.
    pub has: String,
}

impl MissingInput {
    /// The error for the record that does not have it.
    pub fn of(&self, record: &Record) -> InputError {
        InputError::whole(&record.path, self.to_string(), format!("a column of role {}", self.what))
    }
}

/// Component number of a circle's radial error.
/// It is the projection of the errors of the circle's two axes.
pub(super) const RADIAL: usize = 2;

/// The states of an effect between two pieces of a record, one per component.
pub(crate) type States = [EffectMemory; 2];

/// The columns of a record that an effect reads.
/// They do not depend on the values of the effect's parameters, so a search over non-linear parameters binds
/// once.
#[derive(Debug, Clone, Default)]
pub struct EffectInputColumns<'r> {
    rows: usize,
    pub(super) t_s: &'r [f64],
    pub(super) p_mm: [Option<&'r [f64]>; 3],
    dir: Option<&'r [f64]>,
    dir_from_velocity: bool,
    /// How far beyond its end targets the axis turned, mm.
    past_mm: f64,
    v: Option<&'r [f64]>,
    a: Option<&'r [f64]>,
    load: Option<&'r [f64]>,
    delta: Option<ResolvedTemperatureDifference<&'r [f64]>>,
    rpm: Option<&'r [f64]>,
    coolant: Option<&'r [f64]>,
    angle: Option<&'r [f64]>,
    channel: Option<&'r [f64]>,
    taken_as_zero: Vec<Role>,
    /// In a circle: the share of each component's error in the radial error.
    share: [Option<&'r [f64]>; 2],
}

impl EffectInputColumns<'_> {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Quantities that the effect reads and the record lacks.
    /// They are taken as zero: at rest, dry, unloaded.
    pub fn taken_as_zero(&self) -> &[Role] {
        &self.taken_as_zero
    }

    /// All inputs of the effect at one row.
    pub fn input(&self, row: usize) -> Input {
        let at = |column: Option<&[f64]>| column.map_or(0.0, |c| c[row]);
        let dir = at(self.dir);
        Input {
            t_s: self.t_s[row],
            p_mm: self.p_mm.map(at),
            dir: if self.dir_from_velocity { sign(dir) } else { dir },
            past_mm: self.past_mm,
            v_mm_s: at(self.v),
            a_mm_s2: at(self.a),
            load_n: at(self.load),
            delta_k: self.delta_k(row),
            rpm: at(self.rpm),
            coolant: at(self.coolant),
            angle_rad: at(self.angle),
            channel: at(self.channel),
        }
    }

    /// The temperature difference at a row, K.
    pub(super) fn delta_k(&self, row: usize) -> f64 {
        self.delta.map_or(0.0, |delta| delta.kelvin(|degc| degc[row]))
    }

    /// Basis values of `effect` over the record, column by column.
    /// `out[k·rows + row]` belongs to coefficient k.
    ///
    /// # Panics
    /// When `out` does not have rows × coefficients places.
    pub fn basis(&self, effect: &Effect, component: usize, out: Out<'_>) {
        self.basis_on(effect, component, &mut States::default(), out);
    }

    /// As [`EffectInputColumns::basis`], for rows that continue those of `states`.
    pub(crate) fn basis_on(&self, effect: &Effect, component: usize, states: &mut States, out: Out<'_>) {
        assert_eq!(out.len(), self.rows * effect.coefficient_count(), "one column per coefficient");
        self.projected(component, out, |component, out| {
            effect.law.basis_rows(effect, self, component, &mut states[component], out);
        });
    }

    /// Fills the columns of one component.
    /// For [`RADIAL`] it fills the sum of both components, each times its share.
    fn projected(&self, component: usize, out: Out<'_>, mut fill: impl FnMut(usize, Out<'_>)) {
        if component != RADIAL {
            return fill(component, out);
        }
        out.fill(0.0);
        let mut buffer = vec![0.0; out.len()];
        for (component, share) in self.share.iter().enumerate() {
            let Some(share) = share else { continue };
            fill(component, &mut buffer);
            for (o, b) in out.chunks_mut(self.rows.max(1)).zip(buffer.chunks(self.rows.max(1))) {
                o.iter_mut().zip(b).zip(*share).for_each(|((o, b), share)| *o += share * b);
            }
        }
    }

    /// Adds the effect to `out` at every row.
    ///
    /// # Panics
    /// When `out` does not have one place per row.
    pub fn add(&self, effect: &Effect, component: usize, out: Out<'_>) {
        self.add_on(effect, component, &mut States::default(), out);
    }

    /// As [`EffectInputColumns::add`], for rows that continue those of `states`.
    pub(crate) fn add_on(&self, effect: &Effect, component: usize, states: &mut States, out: Out<'_>) {
        assert_eq!(out.len(), self.rows, "one place per row");
        let coefficients = effect.coefficients();
        let mut columns = vec![0.0; self.rows * coefficients.len()];
        self.basis_on(effect, component, states, &mut columns);
        for (c, column) in coefficients.iter().zip(columns.chunks(self.rows.max(1))) {
            for (o, b) in out.iter_mut().zip(column) {
                *o += c * b;
            }
        }
    }

    /// Derivative of the effect by every parameter value, column by column.
    /// `out[i·rows + row]` belongs to value i of [`Effect::values`]. Columns of parameters that are chosen
    /// before the fit are zero.
    ///
    /// # Panics
    /// When `out` does not have rows × values places.
    pub fn slopes(&self, effect: &Effect, component: usize, out: Out<'_>) {
        let n = effect.values.len();
        assert_eq!(out.len(), self.rows * n, "one column per parameter value");
        self.projected(component, out, |component, out| {
            let mut state = EffectMemory::default();
            let mut buffer = vec![0.0; n];
            for row in 0..self.rows {
                buffer.fill(0.0);
                effect.law.slopes(effect, &self.input(row), component, &mut state, &mut buffer);
                for (i, v) in buffer.iter().enumerate() {
                    out[i * self.rows + row] = *v;
                }
            }
        });
    }
}

impl Effect {
    /// Finds the columns that this effect reads.
    ///
    /// # Errors
    /// A sensor or channel that the record does not have. A quantity that it does not log (velocity, load, …) is
    /// taken as zero and listed in [`EffectInputColumns::taken_as_zero`].
    pub fn bind<'r>(&self, record: &'r Record) -> Result<EffectInputColumns<'r>, MissingInput> {
        let named = |data: Option<&'r [f64]>, role: &Role, name: &str| {
            data.ok_or_else(|| MissingInput {
                effect: self.name(),
                what: format!("{role}.{name}"),
                has: record.names(role).collect::<Vec<_>>().join(", "),
            })
        };
        let mut bound = EffectInputColumns {
            rows: record.rows(),
            t_s: record.time_s(),
            past_mm: record.overtravel_mm(),
            ..EffectInputColumns::default()
        };
        // Only a pair acts on its second axis.
        let acts_on = if self.description().naming == EffectNameAxes::Pair { 2 } else { 1 };
        for (share, axis) in bound.share.iter_mut().zip(&self.axes[..acts_on.min(self.axes.len())]) {
            *share = record.share(axis);
        }
        for &need in &self.description().needs {
            let role = need.role(&self.axes);
            let data = record.data(&role);
            let place = match need {
                RequiredInput::Time => continue,
                RequiredInput::Delta => {
                    let Some(d) = &self.delta else { continue };
                    bound.delta = Some(d.find(|sensor| named(record.temperature(sensor), &role, sensor))?);
                    continue;
                }
                RequiredInput::Channel => {
                    let name = self.channel().unwrap_or_default();
                    bound.channel = Some(named(record.channel(name), &role, name)?);
                    continue;
                }
                RequiredInput::Direction if data.is_none() => {
                    bound.dir = record.data(&Role::Velocity(self.axes[0].clone()));
                    bound.dir_from_velocity = true;
                    if bound.dir.is_none() {
                        bound.taken_as_zero.push(role);
                    }
                    continue;
                }
                RequiredInput::Position(n) => &mut bound.p_mm[n],
                RequiredInput::Direction => &mut bound.dir,
                RequiredInput::Velocity => &mut bound.v,
                RequiredInput::Acceleration => &mut bound.a,
                RequiredInput::Load => &mut bound.load,
                RequiredInput::SpindleSpeed => &mut bound.rpm,
                RequiredInput::Coolant => &mut bound.coolant,
                RequiredInput::Angle => &mut bound.angle,
            };
            *place = data;
            if data.is_none() {
                bound.taken_as_zero.push(role);
            }
        }
        Ok(bound)
    }
}
