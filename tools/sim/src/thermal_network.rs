//! Heat in the machine: a lumped network of thermal masses.
//! The spindle and the coolant drive it.
//!
//! It is tuned to the machining centre of WO 97/43703. At 5500 rpm the sensor at the spindle's nose rises by
//! some 16 K in three hours (figure 17). With coolant the front of the housing stays cool while its rear
//! heats. The gradient along the housing is therefore larger wet than dry (text after table 7).

use crate::noise::NoiseGenerator;

/// A thermal mass of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum ThermalNode {
    FrontBearing,
    RearBearing,
    Motor,
    HousingFront,
    HousingMiddle,
    HousingRear,
    Headstock,
    Column,
    Bed,
    Table,
    Coolant,
    Ambient,
}

const NODES: usize = 12;

/// Heat capacities, J/K, in the order of [`ThermalNode`].
/// The ambient is a boundary.
const CAPACITY: [f64; NODES] =
    [2.5e3, 2.5e3, 9.0e3, 1.4e4, 1.6e4, 1.4e4, 6.0e4, 3.0e5, 5.0e5, 1.5e5, 2.5e5, f64::INFINITY];

/// Thermal conductances between two masses, W/K.
const CONDUCTANCE: [(ThermalNode, ThermalNode, f64); 21] = [
    (ThermalNode::FrontBearing, ThermalNode::HousingFront, 45.0),
    (ThermalNode::RearBearing, ThermalNode::HousingRear, 40.0),
    (ThermalNode::Motor, ThermalNode::RearBearing, 6.0),
    (ThermalNode::Motor, ThermalNode::HousingRear, 4.0),
    (ThermalNode::HousingFront, ThermalNode::HousingMiddle, 60.0),
    (ThermalNode::HousingMiddle, ThermalNode::HousingRear, 40.0),
    (ThermalNode::HousingMiddle, ThermalNode::Headstock, 12.0),
    (ThermalNode::HousingRear, ThermalNode::Headstock, 6.0),
    (ThermalNode::Headstock, ThermalNode::Column, 10.0),
    (ThermalNode::Column, ThermalNode::Bed, 15.0),
    (ThermalNode::Bed, ThermalNode::Table, 10.0),
    (ThermalNode::FrontBearing, ThermalNode::Ambient, 1.5),
    (ThermalNode::Motor, ThermalNode::Ambient, 9.0),
    (ThermalNode::HousingFront, ThermalNode::Ambient, 6.0),
    (ThermalNode::HousingMiddle, ThermalNode::Ambient, 3.0),
    (ThermalNode::HousingRear, ThermalNode::Ambient, 5.0),
    (ThermalNode::Headstock, ThermalNode::Ambient, 12.0),
    (ThermalNode::Column, ThermalNode::Ambient, 30.0),
    (ThermalNode::Bed, ThermalNode::Ambient, 30.0),
    (ThermalNode::Table, ThermalNode::Ambient, 15.0),
    (ThermalNode::Coolant, ThermalNode::Ambient, 25.0),
];

/// Additional conductances while coolant flows, W/K.
const WET: [(ThermalNode, ThermalNode, f64); 4] = [
    (ThermalNode::HousingFront, ThermalNode::Coolant, 30.0),
    (ThermalNode::FrontBearing, ThermalNode::Coolant, 8.0),
    (ThermalNode::Table, ThermalNode::Coolant, 60.0),
    (ThermalNode::Bed, ThermalNode::Coolant, 20.0),
];

/// Heat at 5500 rpm, W, and its share that grows with the square of the speed.
/// The rest grows with the speed.
const SOURCES: [(ThermalNode, f64, f64); 3] = [
    (ThermalNode::FrontBearing, 170.0, 0.6),
    (ThermalNode::RearBearing, 135.0, 0.6),
    (ThermalNode::Motor, 185.0, 0.3),
];

/// Heat that the coolant's pump puts into it, W.
const PUMP_W: f64 = 300.0;

/// The sensors: name, mass at which it sits, neighbour, and the neighbour's share.
pub const SENSORS: [(&str, ThermalNode, ThermalNode, f64); 20] = [
    ("T1", ThermalNode::Bed, ThermalNode::Ambient, 0.1),
    ("T2", ThermalNode::Bed, ThermalNode::Table, 0.4),
    ("T3", ThermalNode::Column, ThermalNode::Bed, 0.3),
    ("T4", ThermalNode::Column, ThermalNode::Ambient, 0.1),
    ("T5", ThermalNode::Column, ThermalNode::Headstock, 0.3),
    ("T6", ThermalNode::Headstock, ThermalNode::HousingMiddle, 0.3),
    ("T7", ThermalNode::HousingMiddle, ThermalNode::HousingFront, 0.2),
    ("T8", ThermalNode::HousingFront, ThermalNode::HousingMiddle, 0.2),
    ("T9", ThermalNode::HousingRear, ThermalNode::HousingMiddle, 0.2),
    ("T10", ThermalNode::FrontBearing, ThermalNode::HousingFront, 0.5),
    ("T11", ThermalNode::Headstock, ThermalNode::Column, 0.3),
    ("T12", ThermalNode::RearBearing, ThermalNode::HousingRear, 0.4),
    ("T13", ThermalNode::FrontBearing, ThermalNode::HousingFront, 0.2),
    ("T14", ThermalNode::Motor, ThermalNode::HousingRear, 0.1),
    ("T15", ThermalNode::Motor, ThermalNode::Ambient, 0.4),
    ("T16", ThermalNode::Headstock, ThermalNode::Ambient, 0.2),
    ("T17", ThermalNode::Table, ThermalNode::Bed, 0.3),
    ("T18", ThermalNode::Table, ThermalNode::Ambient, 0.05),
    ("T19", ThermalNode::Coolant, ThermalNode::Table, 0.0),
    ("T20", ThermalNode::Ambient, ThermalNode::Column, 0.05),
];

/// A machine's thermal properties.
/// Capacities (J/K), conductances dry and wet (W/K), sources at 5500 rpm (W).
#[derive(Debug, Clone)]
pub struct ThermalNetworkSpec {
    capacity: [f64; NODES],
    conductance: [f64; CONDUCTANCE.len()],
    wet: [f64; WET.len()],
    watt: [f64; SOURCES.len()],
}

impl Default for ThermalNetworkSpec {
    fn default() -> Self {
        Self {
            capacity: CAPACITY,
            conductance: CONDUCTANCE.map(|c| c.2),
            wet: WET.map(|c| c.2),
            watt: SOURCES.map(|s| s.1),
        }
    }
}

impl ThermalNetworkSpec {
    /// Another machine of the same build; `factor` scales each property.
    pub fn drawn(factor: &mut impl FnMut() -> f64) -> Self {
        let mut drawn = Self::default();
        let Self { capacity, conductance, wet, watt } = &mut drawn;
        for property in capacity.iter_mut().chain(conductance).chain(wet).chain(watt) {
            *property *= factor();
        }
        drawn
    }
}

/// The thermal network of the machine and the sensors in it.
#[derive(Debug, Clone)]
pub struct ThermalNetwork {
    network: ThermalNetworkSpec,
    /// °C, in the order of [`ThermalNode`].
    temperature: [f64; NODES],
    /// Temperature of the hall without its drift, °C.
    pub(crate) ambient_degc: f64,
    /// Slow drift of the hall's temperature, K.
    drift: f64,
    due_s: f64,
    noise: NoiseGenerator,
    readings: [f64; SENSORS.len()],
    noise_k: f64,
}

/// Time step, s; short compared with the fastest mass (a bearing, a minute).
const STEP_S: f64 = 1.0;

impl ThermalNetwork {
    /// A machine that has stood overnight in a hall of this temperature.
    /// Its sensors have noise of `noise_k`, K.
    pub fn cold(ambient_degc: f64, noise_k: f64, seed: u64) -> Self {
        let mut heat = Self {
            network: ThermalNetworkSpec::default(),
            temperature: [ambient_degc; NODES],
            ambient_degc,
            drift: 0.0,
            due_s: 0.0,
            noise: NoiseGenerator::new(seed, 0x7EA7),
            readings: [ambient_degc; SENSORS.len()],
            noise_k,
        };
        heat.read();
        heat
    }

    /// The same with other thermal properties.
    #[must_use]
    pub fn with_network(self, network: ThermalNetworkSpec) -> Self {
        Self { network, ..self }
    }

    /// Advances to `t_s` with the spindle at `rpm` and coolant on or off.
    pub fn advance(&mut self, t_s: f64, rpm: f64, coolant: bool) {
        while self.due_s + STEP_S <= t_s {
            self.due_s += STEP_S;
            self.step(rpm, coolant);
        }
    }

    fn step(&mut self, rpm: f64, coolant: bool) {
        let mut watt = [0.0; NODES];
        let share = rpm / 5500.0;
        let ThermalNetworkSpec { capacity, conductance, wet, watt: sources } = &self.network;
        for ((node, _, square), w) in SOURCES.iter().zip(sources) {
            watt[*node as usize] += w * (square * share * share + (1.0 - square) * share);
        }
        if coolant {
            watt[ThermalNode::Coolant as usize] += PUMP_W;
        }
        let flooded = WET.iter().zip(wet).filter(|_| coolant);
        for (&(a, b, _), g) in CONDUCTANCE.iter().zip(conductance).chain(flooded) {
            let flow = g * (self.temperature[a as usize] - self.temperature[b as usize]);
            watt[a as usize] -= flow;
            watt[b as usize] += flow;
        }
        for (n, t) in self.temperature.iter_mut().enumerate() {
            *t += watt[n] / capacity[n] * STEP_S;
        }
        // The hall's temperature wanders by some tenths of a kelvin over hours.
        self.drift += 0.002 * self.noise.normal() - self.drift * STEP_S / 7200.0;
        self.temperature[ThermalNode::Ambient as usize] = self.ambient_degc + self.drift;
        self.read();
    }

    fn read(&mut self) {
        for (reading, &(_, node, other, share)) in self.readings.iter_mut().zip(&SENSORS) {
            let t = &self.temperature;
            let noise = if self.noise_k > 0.0 { self.noise_k * self.noise.normal() } else { 0.0 };
            *reading = t[node as usize] * (1.0 - share) + t[other as usize] * share + noise;
        }
    }

    /// Readings of the sensors, °C, in the order of [`SENSORS`].
    pub fn readings_degc(&self) -> &[f64] {
        &self.readings
    }

    /// Temperature of a mass, °C.
    pub fn degc(&self, node: ThermalNode) -> f64 {
        self.temperature[node as usize]
    }
}

/// A spindle cycle: speeds and durations, `(rpm, minutes)`.
pub type Cycle = &'static [(f64, f64)];

/// The spindle cycle of WO 97/43703, figure 9 and table 4.
/// Three hours at 5500 rpm, an hour at rest, an hour at 3000, an hour at rest. Then a quarter of an hour each
/// at 1500, 3000, 5500 and 3000, with five minutes' rest in between.
pub const FIGURE_9: Cycle = &[
    (5500.0, 180.0),
    (0.0, 60.0),
    (3000.0, 60.0),
    (0.0, 60.0),
    (1500.0, 15.0),
    (0.0, 5.0),
    (3000.0, 15.0),
    (0.0, 5.0),
    (5500.0, 15.0),
    (0.0, 5.0),
    (3000.0, 15.0),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn after(hours: f64, rpm: f64, coolant: bool) -> ThermalNetwork {
        let mut heat = ThermalNetwork::cold(20.0, 0.0, 1);
        heat.advance(hours * 3600.0, rpm, coolant);
        heat
    }

    /// WO 97/43703, figure 17: the sensor at the spindle's nose rises by 15 to 16 K.
    #[test]
    fn the_nose_rises_by_sixteen_kelvin() {
        let heat = after(3.0, 5500.0, false);
        let nose = SENSORS.iter().position(|s| s.0 == "T13").unwrap();
        let rise = heat.readings_degc()[nose] - 20.0;
        assert!((15.0..=17.0).contains(&rise), "{rise} K");
    }

    /// The gradient along the housing is larger wet than dry.
    /// (WO 97/43703, after table 7)
    #[test]
    fn the_housing_gradient_is_larger_wet_than_dry() {
        let gradient = |coolant| {
            let heat = after(3.0, 5500.0, coolant);
            (heat.degc(ThermalNode::HousingRear) - heat.degc(ThermalNode::HousingFront)).abs()
        };
        let (dry, wet) = (gradient(false), gradient(true));
        assert!(wet > 1.5 * dry && wet > 1.0, "dry {dry} K, wet {wet} K");
    }

    /// All housing temperatures stay between 20 and 40 °C.
    /// (WO 97/43703, figures 10 and 11)
    #[test]
    fn the_housing_stays_below_forty_degrees() {
        for coolant in [false, true] {
            let heat = after(3.0, 5500.0, coolant);
            for node in [ThermalNode::HousingFront, ThermalNode::HousingMiddle, ThermalNode::HousingRear] {
                let t = heat.degc(node);
                assert!((20.5..40.0).contains(&t), "{node:?} {t} °C");
            }
        }
    }

    /// Random machines warm differently, each within its physics.
    #[test]
    fn drawn_networks_warm_differently() {
        let mut noise = NoiseGenerator::new(1, 1);
        let mut rises: Vec<f64> = (0..20)
            .map(|_| {
                let mut heat = ThermalNetwork::cold(20.0, 0.0, 1)
                    .with_network(ThermalNetworkSpec::drawn(&mut || (0.3 * noise.normal()).exp()));
                heat.advance(3.0 * 3600.0, 5500.0, true);
                heat.degc(ThermalNode::FrontBearing) - 20.0
            })
            .collect();
        rises.sort_by(f64::total_cmp);
        assert!(rises[0] > 3.0 && rises[19] < 40.0 && rises[19] > 1.5 * rises[0], "{rises:?}");
    }

    #[test]
    fn a_cold_machine_stays_cold_and_energy_flows_downhill() {
        let heat = after(2.0, 0.0, false);
        assert!(heat.readings_degc().iter().all(|t| (t - 20.0).abs() < 0.6));
        let mut heat = after(3.0, 5500.0, false);
        let hot = heat.degc(ThermalNode::FrontBearing);
        heat.advance(4.0 * 3600.0, 0.0, false);
        assert!(heat.degc(ThermalNode::FrontBearing) < hot && heat.degc(ThermalNode::FrontBearing) > 20.0);
    }
}
