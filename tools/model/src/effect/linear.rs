//! Effects that are one function of what is read, times one parameter each (or two): no state, no shape parameter.
//!
//! Each is one constant-like function here: its card and its basis.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, State, sign};
use std::sync::Arc;

/// A law whose parameters are all linear.
#[derive(Debug)]
struct Linear {
    card: Card,
    basis: fn(&Input, usize, Out<'_>),
}

impl Law for Linear {
    fn card(&self) -> &Card {
        &self.card
    }

    fn basis(&self, _: &Effect, now: &Input, component: usize, _: &mut State, out: Out<'_>) {
        (self.basis)(now, component, out);
    }
}

/// Name, formula, parameters, needs and basis; then cause and experiment.
struct Entry {
    name: &'static str,
    law: &'static str,
    naming: Naming,
    quantity: Quantity,
    parameters: &'static [(&'static str, &'static str, f64)],
    needs: &'static [Need],
    basis: fn(&Input, usize, Out<'_>),
    cause: &'static str,
    experiment: &'static str,
}

/// The linear effects of formats.md, in its order.
const ENTRIES: &[Entry] = &[
    Entry {
        name: "offset",
        law: "e = um",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um", "um", 2000.0)],
        needs: &[],
        basis: |_, _, out| out[0] = 1.0,
        cause: "zero point, tool length, datum of the gauge",
        experiment: "any run against a datum that is known; two set-ups of the gauge tell it from the datum's own error",
    },
    Entry {
        name: "scale",
        law: "e = ppm·p/1000",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("ppm", "ppm", 2000.0)],
        needs: &[Need::Position(0)],
        basis: |i, _, out| out[0] = i.p_mm[0] / 1000.0,
        cause: "length error of the scale or of the screw's lead, cosine error of the set-up",
        experiment: "linear displacement over the whole travel (ISO 230-2) at a steady, known temperature",
    },
    Entry {
        name: "reversal",
        law: "e = um·dir/2",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um", "um", 200.0)],
        needs: &[Need::Direction],
        basis: |i, _, out| out[0] = i.dir / 2.0,
        cause: "backlash and elastic wind-up between scale and tool",
        experiment: "bidirectional linear displacement, targets approached from both sides (ISO 230-2)",
    },
    Entry {
        name: "squareness",
        law: "e_A = urad·p_B/1000",
        naming: Naming::Two,
        quantity: Quantity::Error,
        parameters: &[("urad", "urad", 2000.0)],
        needs: &[Need::Position(1)],
        basis: |i, _, out| out[0] = i.p_mm[1] / 1000.0,
        cause: "axis B not square to axis A",
        experiment: "ballbar in the plane of both axes (ISO 230-4), or a square on both",
    },
    Entry {
        name: "rotation",
        law: "e_A = −urad·p_B/1000, e_B = +urad·p_A/1000",
        naming: Naming::Pair,
        quantity: Quantity::Error,
        parameters: &[("urad", "urad", 5000.0)],
        needs: &[Need::Position(0), Need::Position(1)],
        basis: |i, component, out| {
            out[0] = if component == 0 { -i.p_mm[1] / 1000.0 } else { i.p_mm[0] / 1000.0 };
        },
        cause: "work or plate turned about the normal of the plane of both axes",
        experiment: "a plate measured in both axes; the same plate turned by a quarter tells it from squareness",
    },
    Entry {
        name: "angular",
        law: "e_A = urad_per_m·p_B·p_C/1e6",
        naming: Naming::Three,
        quantity: Quantity::Error,
        parameters: &[("urad_per_m", "urad/m", 5000.0)],
        needs: &[Need::Position(1), Need::Position(2)],
        basis: |i, _, out| out[0] = i.p_mm[1] * i.p_mm[2] / 1e6,
        cause: "pitch, yaw or roll that grows along one axis, at the lever of another",
        experiment: "the same linear displacement line at two or more offsets of the other axis (ISO 230-1)",
    },
    Entry {
        name: "coolant",
        law: "e = um while coolant is on",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um", "um", 200.0)],
        needs: &[Need::Coolant],
        basis: |i, _, out| out[0] = f64::from(i.coolant > 0.5),
        cause: "coolant's pressure and chill on spindle and work",
        experiment: "coolant switched on and off several times in one warm, steady run",
    },
    Entry {
        name: "spindle_speed",
        law: "e = um_per_krpm·n + um_per_krpm2·n²",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um_per_krpm", "um/krpm", 20.0), ("um_per_krpm2", "um/krpm2", 5.0)],
        needs: &[Need::SpindleSpeed],
        basis: |i, _, out| {
            let n = i.rpm / 1000.0;
            out[0] = n;
            out[1] = n * n;
        },
        cause: "centrifugal growth of bearings and shaft, axial shift under preload",
        experiment: "short runs at several speeds, up and down, faster than the spindle warms (ISO 230-3)",
    },
    Entry {
        name: "following_error",
        law: "e = ms·v",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("ms", "ms", 200.0)],
        needs: &[Need::Velocity],
        basis: |i, _, out| out[0] = i.v_mm_s,
        cause: "lag of the position loop (1/Kv), delay of the reading",
        experiment: "ballbar or straight line at three feeds, both ways",
    },
    Entry {
        name: "acceleration_error",
        law: "e = um_per_m_s2·a/1000",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um_per_m_s2", "um/(m/s2)", 100.0)],
        needs: &[Need::Acceleration],
        basis: |i, _, out| out[0] = i.a_mm_s2 / 1000.0,
        cause: "drive train and structure bending under their own inertia",
        experiment: "feed sweep with the same path at several accelerations",
    },
    Entry {
        name: "stiffness",
        law: "e = um_per_N·load",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("um_per_N", "um/N", 1.0)],
        needs: &[Need::Load],
        basis: |i, _, out| out[0] = i.load_n,
        cause: "compliance between scale and tool or work",
        experiment: "known loads on an axis at rest (ISO 230-1, static compliance)",
    },
    Entry {
        name: "probe_latency",
        law: "e = us·v/1000, in a record of kind probing",
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters: &[("us", "us", 20000.0)],
        needs: &[Need::Velocity],
        basis: |i, _, out| out[0] = i.v_mm_s / 1000.0,
        cause: "time from the probe's contact to the captured position",
        experiment: "one surface probed at several speeds, both ways",
    },
    Entry {
        name: "channel",
        law: "e = gain·NAME",
        naming: Naming::Channel,
        quantity: Quantity::Error,
        parameters: &[("gain", "um/1", f64::INFINITY)],
        needs: &[Need::Channel],
        basis: |i, _, out| out[0] = i.channel,
        cause: "a logged quantity with no physics named",
        experiment: "that quantity varied on its own, everything else held",
    },
    Entry {
        name: "inertia",
        law: "f = kg·a/1000",
        naming: Naming::One,
        quantity: Quantity::Force,
        parameters: &[("kg", "kg", 100_000.0)],
        needs: &[Need::Acceleration],
        basis: |i, _, out| out[0] = i.a_mm_s2 / 1000.0,
        cause: "moved mass, with the drive's inertia referred to the axis",
        experiment: "strokes at several accelerations (dynamics run)",
    },
    Entry {
        name: "friction_viscous",
        law: "f = N_s_per_m·v/1000",
        naming: Naming::One,
        quantity: Quantity::Force,
        parameters: &[("N_s_per_m", "N·s/m", 100_000.0)],
        needs: &[Need::Velocity],
        basis: |i, _, out| out[0] = i.v_mm_s / 1000.0,
        cause: "lubricant sheared in guideways, screw and bearings",
        experiment: "strokes at several steady speeds, both ways (dynamics run)",
    },
    Entry {
        name: "friction_coulomb",
        law: "f = N·sign(v)",
        naming: Naming::One,
        quantity: Quantity::Force,
        parameters: &[("N", "N", 10_000.0)],
        needs: &[Need::Velocity],
        basis: |i, _, out| out[0] = sign(i.v_mm_s),
        cause: "dry friction of guideways, seals and preloaded nuts",
        experiment: "slow strokes both ways (dynamics run)",
    },
    Entry {
        name: "friction_asymmetric",
        law: "f = N_s_per_m·abs(v)/1000",
        naming: Naming::One,
        quantity: Quantity::Force,
        parameters: &[("N_s_per_m", "N·s/m", 100_000.0)],
        needs: &[Need::Velocity],
        basis: |i, _, out| out[0] = i.v_mm_s.abs() / 1000.0,
        cause: "viscous friction that differs by direction",
        experiment: "strokes at several steady speeds, both ways (dynamics run)",
    },
    Entry {
        name: "force_offset",
        law: "f = N",
        naming: Naming::One,
        quantity: Quantity::Force,
        parameters: &[("N", "N", 10_000.0)],
        needs: &[],
        basis: |_, _, out| out[0] = 1.0,
        cause: "weight that is not balanced, amplifier offset, Coulomb friction that differs by direction",
        experiment: "slow strokes both ways (dynamics run)",
    },
];

pub(super) fn laws(laws: &mut Vec<Arc<dyn Law>>) {
    for e in ENTRIES {
        let optional = e.parameters.len() > 1;
        let parameters = e.parameters.iter().enumerate().map(|(i, &(name, unit, plausible))| {
            let p = Parameter::linear(name, unit, plausible);
            // A second, quadratic term may be left out.
            if optional && i == 1 { p.or(0.0) } else { p }
        });
        laws.push(Arc::new(Linear {
            card: Card {
                name: e.name.to_owned(),
                law: e.law.to_owned(),
                cause: e.cause.to_owned(),
                naming: e.naming,
                quantity: e.quantity,
                parameters: parameters.collect(),
                needs: e.needs.to_vec(),
                experiment: e.experiment.to_owned(),
            },
            basis: e.basis,
        }));
    }
}
