"""The laws of a machine's effects and its measurements, by another hand: what `elsewhere.py` makes its cases of.

Written from the formats' description alone, in its own formulas; no line is taken from the programs. An effect is a
dict as in a machine file: its name, and its values by their keys. A `Record` is one measurement; each function below
its class makes one of some kind, as it would be done on a machine, with the effects it can show in `menu`, and without
errors: those are added later. Every draw is from the generator that is handed in, so that a seed is a case.
"""

import json
from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np

TURN = 2 * np.pi
STANDARD_DEGC = 20.0

# --- laws --------------------------------------------------------------------------------------------------------


class Seen:
    """What one effect sees of a record, acting on one axis."""

    def __init__(self, effect, record, axis, logged):
        self.axes = effect["name"].split(".")[1:]
        self.effect, self.record, self.axis, self.logged = effect, record, axis, logged
        self.zeros = np.zeros(record.rows)
        self.time_s = record.time_s
        self.position_mm = record.position_mm.get(axis, self.zeros)
        self.velocity_mm_s = record.velocity_mm_s.get(axis, self.zeros)
        self.acceleration_mm_s2 = record.acceleration_mm_s2.get(axis, self.zeros)
        self.load_n = record.load_n.get(axis, self.zeros)
        self.direction = record.direction.get(axis, np.sign(self.velocity_mm_s))

    def other_mm(self, place):
        """Position of the axis that stands at `place` in the effect's name, counted from 0."""
        return self.record.position_mm.get(self.axes[place], self.zeros)

    def delta_k(self):
        degc = self.record.logged_degc if self.logged else self.record.true_degc
        degc_here = degc[self.effect["sensor"]]
        if "minus" in self.effect:
            return degc_here - degc[self.effect["minus"]]
        return degc_here - self.effect.get("reference_degC", STANDARD_DEGC)

    def coolant(self):
        return self.zeros if self.record.coolant is None else self.record.coolant

    def spindle_krpm(self):
        return (self.zeros if self.record.spindle_rpm is None else self.record.spindle_rpm) / 1000

    def channel(self):
        return self.record.channel.get(self.axes[1], self.zeros)


def lagging(values, time_s, tau_s):
    """First-order lag of what is linear between rows, in equilibrium at its first row."""
    out = np.empty_like(values)
    out[0] = values[0]
    for i in range(1, len(values)):
        step_s = time_s[i] - time_s[i - 1]
        if step_s <= 0:
            out[i] = out[i - 1]
            continue
        slope = (values[i] - values[i - 1]) / step_s
        left = out[i - 1] - values[i - 1] + slope * tau_s
        out[i] = values[i] - slope * tau_s + left * np.exp(-step_s / tau_s)
    return out


def after_reversal(position_mm, direction, length_mm):
    """What decays with the way gone since the last reversal; none before the first."""
    out = np.zeros(len(position_mm))
    last = 0
    reversed_once = False
    gone_mm = 0
    for i, now in enumerate(direction):
        step_mm = abs(position_mm[i] - position_mm[i - 1]) if i > 0 else 0
        gone_mm += step_mm
        if now == 0:
            continue
        if last not in (0, now):
            reversed_once = True
            gone_mm = step_mm
        last = now
        if reversed_once:
            out[i] = now * np.exp(-gone_mm / length_mm)
    return out


def rotation(e, s):
    if s.axis == s.axes[0]:
        return -e["urad"] * s.other_mm(1) / 1000
    return e["urad"] * s.other_mm(0) / 1000


def growth(e, delta_k):
    return e["um_per_K"] * delta_k + e.get("um_per_K2", 0) * delta_k * delta_k


def thermal_lag(e, s):
    return growth(e, lagging(s.delta_k(), s.time_s, e["tau_s"]))


def spindle_speed(e, s):
    krpm = s.spindle_krpm()
    return e["um_per_krpm"] * krpm + e.get("um_per_krpm2", 0) * krpm * krpm


def following_error(e, s):
    return s.zeros if s.record.kind == "probing" else e["ms"] * s.velocity_mm_s


def probe_latency(e, s):
    return e["us"] * s.velocity_mm_s / 1000 if s.record.kind == "probing" else s.zeros


def probe_lobing(e, s):
    return e["um"] * np.cos(e["lobes"] * s.record.angle_rad + e["phase_rad"])


def form_bump(e, s):
    away_rad = (s.record.angle_rad - e["centre_rad"] + np.pi) % TURN - np.pi
    bump = e["um"] * (1 + np.cos(TURN * away_rad / e["width_rad"])) / 2
    return np.where(abs(away_rad) <= e["width_rad"] / 2, bump, 0)


def wave(e, s, period_mm):
    return e["um"] * np.sin(TURN * s.position_mm / period_mm + e["phase_rad"])


def subdivision(e, s):
    return e["um"] * np.sin(TURN * s.position_mm * 1000 / e["period_um"] + e["phase_rad"])


# Of each kind: the values that its size lies in, the largest that any machine has, how many values make its shape, and
# its law.
Kind = namedtuple("Kind", "sizes largest shape_values law")
KINDS = {
    "offset": Kind(["um"], 2000, 0, lambda e, s: e["um"] + s.zeros),
    "scale": Kind(["ppm"], 1000, 0, lambda e, s: e["ppm"] * s.position_mm / 1000),
    "position_map": Kind(["um"], 500, 0, lambda e, s: np.interp(s.position_mm, e["knots_mm"], e["um"])),
    "straightness": Kind(["um"], 500, 0, lambda e, s: np.interp(s.other_mm(1), e["knots_mm"], e["um"])),
    "screw_periodic": Kind(["um"], 100, 2, lambda e, s: wave(e, s, e["period_mm"])),
    "subdivision": Kind(["um"], 5, 2, subdivision),
    "reversal": Kind(["um"], 200, 0, lambda e, s: e["um"] * s.direction / 2),
    "reversal_spike": Kind(["um"], 100, 1,
                           lambda e, s: e["um"] * after_reversal(s.position_mm, s.direction, e["length_mm"])),
    "squareness": Kind(["urad"], 2000, 0, lambda e, s: e["urad"] * s.other_mm(1) / 1000),
    "rotation": Kind(["urad"], 5000, 0, rotation),
    "angular": Kind(["urad_per_m"], 5000, 0, lambda e, s: e["urad_per_m"] * s.other_mm(1) * s.other_mm(2) / 1e6),
    "thermal_expansion": Kind(["ppm_per_K"], 50, 0, lambda e, s: e["ppm_per_K"] * s.delta_k() * s.position_mm / 1000),
    "thermal_growth": Kind(["um_per_K", "um_per_K2"], 60, 0, lambda e, s: growth(e, s.delta_k())),
    "thermal_lag": Kind(["um_per_K", "um_per_K2"], 60, 1, thermal_lag),
    "warm_up": Kind(["um"], 500, 1, lambda e, s: e["um"] * (1 - np.exp(-s.time_s / e["tau_s"]))),
    "coolant": Kind(["um"], 200, 0, lambda e, s: e["um"] * s.coolant()),
    "spindle_speed": Kind(["um_per_krpm", "um_per_krpm2"], 20, 0, spindle_speed),
    "following_error": Kind(["ms"], 200, 0, following_error),
    "acceleration_error": Kind(["um_per_m_s2"], 100, 0, lambda e, s: e["um_per_m_s2"] * s.acceleration_mm_s2 / 1000),
    "stiffness": Kind(["um_per_N"], 1, 0, lambda e, s: e["um_per_N"] * s.load_n),
    "lost_counts": Kind(["um"], np.inf, 1, lambda e, s: e["um"] * (s.time_s >= e["at_s"])),
    "probe_latency": Kind(["us"], 20000, 0, probe_latency),
    "probe_lobing": Kind(["um"], 50, 2, probe_lobing),
    "form_bump": Kind(["um"], 500, 2, form_bump),
    "channel": Kind(["gain"], np.inf, 0, lambda e, s: e["gain"] * s.channel()),
    "inertia": Kind(["kg"], np.inf, 0, lambda e, s: e["kg"] * s.acceleration_mm_s2 / 1000),
    "friction_viscous": Kind(["N_s_per_m"], np.inf, 0, lambda e, s: e["N_s_per_m"] * s.velocity_mm_s / 1000),
    "friction_coulomb": Kind(["N"], np.inf, 0, lambda e, s: e["N"] * np.sign(s.velocity_mm_s)),
    "friction_asymmetric": Kind(["N_s_per_m"], np.inf, 0, lambda e, s: e["N_s_per_m"] * abs(s.velocity_mm_s) / 1000),
    "force_offset": Kind(["N"], np.inf, 0, lambda e, s: e["N"] + s.zeros),
}
FORCES = {"inertia", "friction_viscous", "friction_coulomb", "friction_asymmetric", "force_offset"}
NOT_NEGATIVE = {"inertia", "friction_viscous", "friction_coulomb"}  # no machine has a mass or a friction below zero
ROUND = {"probe_lobing", "form_bump"}  # these act along the radius, over the angle


def kind_of(effect_or_name):
    name = effect_or_name if isinstance(effect_or_name, str) else effect_or_name["name"]
    return name.split(".")[0]


def acts_on(effect, axis):
    axes = effect["name"].split(".")[1:]
    return axis in (axes[:2] if kind_of(effect) == "rotation" else axes[:1])


def contribution(effect, record, response, logged=False):
    """What an effect adds to a response, as "error.x", "error.r" or "force.x"; zeros where it does not act.

    By the true temperatures, or by those the log holds.
    """
    quantity, axis = response.split(".")
    kind = kind_of(effect)
    law = KINDS[kind].law
    zeros = np.zeros(record.rows)
    if (quantity == "force") != (kind in FORCES):
        return zeros
    if kind in ROUND:
        along_radius = response == "error.r" or len(record.responses) == 1
        if record.angle_rad is None or not along_radius:
            return zeros
        return law(effect, Seen(effect, record, axis, logged))
    if axis != "r":
        return law(effect, Seen(effect, record, axis, logged)) if acts_on(effect, axis) else zeros
    for part, direction in zip(record.plane or [], (np.cos, np.sin)):
        if acts_on(effect, part):
            zeros = zeros + law(effect, Seen(effect, record, part, logged)) * direction(record.angle_rad)
    return zeros


def scaled(effect, factor):
    """The same effect, as many times as large."""
    out = dict(effect)
    for key in KINDS[kind_of(effect)].sizes:
        if key in effect:
            value = effect[key]
            out[key] = [each * factor for each in value] if isinstance(value, list) else value * factor
    return out


# --- records -----------------------------------------------------------------------------------------------------


@dataclass
class Record:
    """One measurement: its columns, then what stands in its run.toml, then what the maker of cases wants to know."""

    name: str
    kind: str  # as the formats name it: positioning, plate, ballbar, drift, feed_sweep, probing, part, dynamics
    rows: int
    position_mm: dict = field(default_factory=dict)  # by axis, as all up to the loads
    direction: dict = field(default_factory=dict)
    velocity_mm_s: dict = field(default_factory=dict)
    acceleration_mm_s2: dict = field(default_factory=dict)
    load_n: dict = field(default_factory=dict)
    true_degc: dict = field(default_factory=dict)  # by sensor
    logged_degc: dict = field(default_factory=dict)
    channel: dict = field(default_factory=dict)
    error: dict = field(default_factory=dict)  # by response; um, or N
    time_s: np.ndarray = None
    cycle: np.ndarray = None
    spindle_rpm: np.ndarray = None
    coolant: np.ndarray = None
    angle_rad: np.ndarray = None

    responses: list = field(default_factory=list)
    time_logged: bool = True
    plane: list = None  # of a ballbar
    radius_mm: float = None
    count_um: float = None
    zero: str = None  # name of the gauge's zero

    menu: list = field(default_factory=list)  # names of effects that it can show
    room: str = None  # sensor of the room
    hot: list = field(default_factory=list)  # sensors that follow the heat
    both_ways: bool = False
    low_mm: float = None
    travel_mm: float = None
    targets: int = None
    extent: dict = field(default_factory=dict)  # of a plate: low end and length, mm, by axis
    feed_mm_s: float = None
    period_um: float = None  # of the scale's signals


def temperatures(rng, record, heat, sensors=None, span_k=None):
    """A room, sensors that follow the heat with lags of their own, and where there are many, one that goes nowhere."""
    time_s = record.time_s - record.time_s[0]
    sensors = sensors or rng.integers(2, 6)
    room_degc = rng.uniform(18, 23)
    length_s = max(time_s[-1], 1)
    day_k = rng.uniform(0.2, 1.5)
    day_k = day_k * np.sin(TURN * time_s / rng.uniform(1.5 * length_s, 6 * length_s) + rng.uniform(0, 6))
    names = [f"{'T' if rng.random() < 0.7 else 'PT'}{i}" for i in rng.permutation(np.arange(1, 25))[:sensors]]
    for i, name in enumerate(names):
        if i == 0:
            degc = room_degc + day_k
            record.room = name
        elif i == sensors - 1 and sensors > 3:
            degc = np.full(record.rows, room_degc + rng.uniform(-0.5, 0.5))
        else:
            tau_s = max(length_s * 10 ** rng.uniform(-1.9, -0.5), 60)
            degc = room_degc + day_k * rng.uniform(0.2, 1)
            degc = degc + lagging(heat, time_s, tau_s) * rng.uniform(0.4, 1) * (span_k or rng.uniform(4, 18))
            record.hot.append(name)
        record.true_degc[name] = degc
    noise_k = 10 ** rng.uniform(-2.3, -1.4)
    step_k = rng.choice([0.001, 0.01])
    for name in names:
        degc = record.true_degc[name] + noise_k * rng.standard_normal(record.rows)
        record.logged_degc[name] = np.round(degc / step_k) * step_k


def uneven(rng, low, high, count, even=False):
    """Targets, their distances not all alike, as standards ask for."""
    places = np.linspace(low, high, count)
    if not even:
        places[1:-1] += rng.uniform(-0.3, 0.3, count - 2) * (high - low) / (count - 1)
    return places


def there_and_back(places, cycles, both_ways=True):
    """Positions, directions and numbers of cycles along a line."""
    ways = [(places, 1), (places[::-1], -1)] if both_ways else [(places, 1)]
    position = np.concatenate([way for _ in range(cycles) for way, _ in ways])
    direction = np.concatenate([np.full(len(way), float(sign)) for _ in range(cycles) for way, sign in ways])
    cycle = np.repeat(np.arange(1.0, cycles + 1), len(ways) * len(places))
    return position, direction, cycle


def line(rng, name, axis, travel_mm=None, cross=None, warm=False, low_mm=None):
    """positioning: a laser along an axis; `cross`: across it too; `warm`: the machine warms up between cycles."""
    travel_mm = travel_mm or 10 ** rng.uniform(np.log10(80), np.log10(6000))
    targets = int(rng.integers(11, 46))
    cycles = int(rng.integers(2, 6))
    both_ways = bool(rng.random() < 0.8)
    cycles = max(cycles, int(np.ceil(90 / (targets * (1 + both_ways)))))
    if low_mm is None:
        low_mm = rng.choice([0, -travel_mm / 2, -travel_mm, rng.uniform(-travel_mm, 0)])
    places_mm = uneven(rng, low_mm, low_mm + travel_mm, targets, even=rng.random() >= 0.85)
    position_mm, direction, cycle = there_and_back(places_mm, cycles, both_ways)
    record = Record(name, "positioning", len(position_mm), direction={axis: direction}, cycle=cycle)
    if rng.random() < 0.6:  # no machine stops where it was told to
        position_mm = position_mm + rng.uniform(0.0005, 0.01) * rng.standard_normal(record.rows)
    record.position_mm[axis] = np.round(position_mm, 4)
    way_mm = np.abs(np.diff(position_mm, prepend=position_mm[0]))
    record.time_s = np.round(np.cumsum(way_mm / rng.uniform(20, 300) + rng.uniform(2, 8)), 2)
    heat = 0.1 * np.linspace(0, 1, record.rows)
    if warm:
        record.time_s = np.round(record.time_s + (cycle - 1) * rng.uniform(600, 2400), 2)
        heat = 1 - np.exp(-record.time_s / (record.time_s[-1] * rng.uniform(0.2, 0.6)))
    temperatures(rng, record, heat, span_k=rng.uniform(6, 16) if warm else rng.uniform(1, 4))
    record.responses = [f"error.{axis}"] + ([f"error.{cross}"] if cross else [])
    record.menu = [f"{kind}.{axis}" for kind in ("scale", "position_map", "offset", "lost_counts", "screw_periodic")]
    if both_ways:
        record.menu += [f"reversal.{axis}"]
    if warm:
        record.menu += [f"thermal_expansion.{axis}", f"warm_up.{axis}", f"thermal_growth.{axis}"]
    if cross:
        record.menu += [f"straightness.{cross}.{axis}", f"squareness.{cross}.{axis}"]
    record.both_ways, record.low_mm, record.travel_mm, record.targets = both_ways, low_mm, travel_mm, targets
    return record


def lines_apart(rng, name, axis, other):
    """positioning: the same line at two to four places of another axis."""
    travel_mm = rng.uniform(150, 1500)
    width_mm = rng.uniform(100, 800)
    lines = int(rng.integers(2, 5))
    targets = int(rng.integers(9, 20))
    parts = []
    for repeat in range(int(rng.integers(1, 3))):
        low_mm = -width_mm / 2 if rng.random() < 0.5 else 0
        for other_mm in np.linspace(low_mm, width_mm, lines):
            position_mm, direction, cycle = there_and_back(uneven(rng, 0, travel_mm, targets), 1)
            parts.append((position_mm, np.full(2 * targets, other_mm), direction, cycle + repeat))
    position_mm, other_mm, direction, cycle = map(np.concatenate, zip(*parts))
    record = Record(name, "positioning", len(position_mm), direction={axis: direction}, cycle=cycle)
    record.position_mm = {axis: np.round(position_mm, 3), other: np.round(other_mm, 3)}
    record.time_s = np.round(np.cumsum(np.full(record.rows, rng.uniform(3, 9))), 1)
    temperatures(rng, record, 0.1 * np.linspace(0, 1, record.rows), span_k=2)
    record.responses = [f"error.{axis}"]
    first, second = sorted([axis, other])
    record.menu = [f"angular.{axis}.{first}.{second}", f"squareness.{axis}.{other}"]
    record.menu += [f"scale.{axis}", f"reversal.{axis}", f"position_map.{axis}"]
    record.both_ways, record.low_mm, record.travel_mm, record.targets = True, 0, travel_mm, targets
    return record


def plate(rng, name, a="x", b="y"):
    """plate: a grid of marks, gone through in rows to and fro."""
    columns, lines = rng.integers(5, 12, 2)
    length_mm = rng.uniform(100, 900)
    width_mm = rng.uniform(100, 700)
    repeats = int(rng.integers(1, 4))
    repeats = max(repeats, int(np.ceil(60 / (columns * lines))))
    rng.choice([0, -length_mm / 2])  # of no use; without it every seed would be another case than it has been
    a_low_mm = rng.choice([0, -length_mm / 2])
    b_low_mm = rng.choice([0, -width_mm / 2])
    a_mm = np.linspace(a_low_mm, a_low_mm + length_mm, columns)
    b_mm = np.linspace(b_low_mm, b_low_mm + width_mm, lines)
    once_mm = np.concatenate([a_mm if j % 2 == 0 else a_mm[::-1] for j in range(lines)])
    record = Record(name, "plate", repeats * columns * lines)
    record.position_mm = {
        a: np.round(np.tile(once_mm, repeats), 3),
        b: np.round(np.tile(np.repeat(b_mm, columns), repeats), 3),
    }
    record.cycle = np.repeat(np.arange(1.0, repeats + 1), columns * lines)
    record.time_s = np.round(np.cumsum(np.full(record.rows, rng.uniform(5, 20))), 1)
    record.time_logged = bool(rng.random() < 0.6)
    temperatures(rng, record, 0.1 * np.linspace(0, 1, record.rows), sensors=2, span_k=1)
    record.responses = [f"error.{a}", f"error.{b}"]
    record.extent = {a: (a_low_mm, length_mm), b: (b_low_mm, width_mm)}
    pair = ".".join(sorted([a, b]))
    record.menu = [f"scale.{a}", f"scale.{b}", f"rotation.{pair}", f"squareness.{a}.{b}"]
    record.menu += [f"straightness.{a}.{b}", f"straightness.{b}.{a}", f"angular.{a}.{pair}", f"angular.{b}.{pair}"]
    record.menu += [f"offset.{a}", f"position_map.{b}"]
    return record


def ballbar(rng, name, a="x", b="y", radius_mm=None, feed_mm_s=None, radial=False):
    """ballbar: a circle each way, by a grid encoder that reads both axes; `radial`: by a bar, along the radius."""
    radius_mm = radius_mm or float(rng.choice([50, 100, 150, 300]))
    feed_mm_s = feed_mm_s or rng.uniform(300, 6000) / 60
    rows_each_way = int(rng.integers(120, 400))
    sweep_rad = rng.choice([TURN, TURN * 1.25])
    start_rad = rng.uniform(0, TURN)
    rad_s = feed_mm_s / radius_mm
    way_rad = np.linspace(0, sweep_rad, rows_each_way)
    angle_rad = np.concatenate([start_rad + way_rad, start_rad + sweep_rad - way_rad])
    sign = np.repeat([1.0, -1.0], rows_each_way)
    step_s = sweep_rad / rad_s / (rows_each_way - 1)
    way_s = np.arange(rows_each_way) * step_s
    time_s = np.r_[way_s, way_s + rows_each_way * step_s + rng.uniform(2, 20)]
    a_mm, b_mm = (0, 0) if rng.random() < 0.6 else (rng.uniform(-300, 300), rng.uniform(-300, 300))
    if radial:
        a_mm = b_mm = 0
    record = Record(name, "ballbar", 2 * rows_each_way, plane=[a, b], radius_mm=radius_mm, feed_mm_s=feed_mm_s)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    record.position_mm = {a: np.round(a_mm + radius_mm * cosine, 4), b: np.round(b_mm + radius_mm * sine, 4)}
    record.velocity_mm_s = {
        a: np.round(-radius_mm * rad_s * sine * sign, 4),
        b: np.round(radius_mm * rad_s * cosine * sign, 4),
    }
    record.acceleration_mm_s2 = {
        a: np.round(-radius_mm * rad_s * rad_s * cosine, 3),
        b: np.round(-radius_mm * rad_s * rad_s * sine, 3),
    }
    for axis, mm_s in record.velocity_mm_s.items():
        record.direction[axis] = np.where(np.sign(mm_s) == 0, 1, np.sign(mm_s))
    record.angle_rad = np.round(angle_rad, 6)
    record.time_s = np.round(time_s, 4)
    record.cycle = np.repeat([1.0, 2.0], rows_each_way)
    record.responses = ["error.r"] if radial else [f"error.{a}", f"error.{b}"]
    if rng.random() < 0.3:
        temperatures(rng, record, np.zeros(record.rows), sensors=2, span_k=1)
    record.menu = [f"reversal.{a}", f"reversal.{b}", f"reversal_spike.{a}", f"reversal_spike.{b}"]
    record.menu += [f"squareness.{a}.{b}", f"scale.{a}", f"scale.{b}"]
    if not radial:
        record.menu += [f"following_error.{a}", f"following_error.{b}", f"screw_periodic.{a}"]
        record.menu += [f"rotation.{'.'.join(sorted([a, b]))}"]
    return record


def other_channel(rng, rows):
    """A signal that has nothing to do with the machine: a walk, noise, or steps to and fro."""
    sort = rng.integers(3)
    level = rng.uniform(1, 60)
    if sort == 0:
        moving = np.cumsum(rng.standard_normal(rows)) * 0.3
    elif sort == 1:
        moving = rng.standard_normal(rows)
    else:
        moving = (np.floor(np.arange(rows) / rng.integers(7, 40)) % 2) * rng.uniform(1, 5)
    return np.round(level + moving, 3)


def drift(rng, name, axes=None):
    """drift: gauges at the nose over hours; the spindle runs at some speeds, coolant goes on and off."""
    rows = int(rng.integers(150, 480))
    step_s = float(rng.choice([10, 20, 30, 60, 120]))
    record = Record(name, "drift", rows)
    even = rng.random() < 0.5
    late_s = rng.uniform(0, 0.2 * step_s, rows)
    record.time_s = np.round(np.arange(rows) * step_s + np.where(even, 0, late_s), 1)
    top_rpm = rng.choice([3000, 6000, 8000, 12000, 18000])
    changes = int(rng.integers(3, 8))
    cuts = np.sort(rng.choice(np.arange(5, rows - 5), changes, replace=False))
    levels_rpm = [rng.choice([0, 0.25, 0.5, 0.75, 1.0]) * top_rpm for _ in range(changes)]
    if max(levels_rpm) == 0:
        levels_rpm[0] = top_rpm
    record.spindle_rpm = np.zeros(rows)
    for cut, rpm in zip(cuts, levels_rpm):
        record.spindle_rpm[cut:] = rpm
    record.coolant = np.zeros(rows)
    for cut in rng.choice(np.arange(5, rows - 5), int(rng.integers(4, 9)), replace=False):
        record.coolant[cut:] = 1 - record.coolant[cut:]
    heat = (record.spindle_rpm / top_rpm) ** rng.uniform(0.8, 1.6) - 0.15 * record.coolant
    temperatures(rng, record, heat, sensors=int(rng.integers(3, 8)))
    for channel in ("oil_bar", "mist", "load_pct", "humid")[:int(rng.integers(0, 4))]:
        record.channel[channel] = other_channel(rng, rows)
    axes = axes or list(rng.choice(["x", "y", "z"], int(rng.integers(1, 4)), replace=False))
    record.responses = [f"error.{axis}" for axis in axes]
    kinds = ("thermal_growth", "thermal_lag", "warm_up", "coolant", "spindle_speed", "lost_counts", "offset")
    for axis in axes:
        record.menu += [f"{kind}.{axis}" for kind in kinds]
        record.menu += [f"channel.{axis}.{channel}" for channel in record.channel]
    return record


def stroke(rows, travel_mm, feed_mm_s, top_mm_s2):
    """One stroke: time, position, velocity, acceleration of its rows, some in the ramps; how long it takes, s."""
    ramp_s = feed_mm_s / top_mm_s2
    total_s = travel_mm / feed_mm_s + ramp_s
    time_s = np.linspace(0.02, 0.98, rows) * total_s
    time_s[:3] = np.linspace(0.15, 0.85, 3) * ramp_s
    time_s[-3:] = total_s - np.linspace(0.85, 0.15, 3) * ramp_s
    time_s = np.sort(time_s)
    up, even = time_s < ramp_s, time_s < total_s - ramp_s
    left_s = total_s - time_s
    along_mm = 0.5 * feed_mm_s * ramp_s + feed_mm_s * (time_s - ramp_s)
    position_mm = np.where(even, along_mm, travel_mm - 0.5 * top_mm_s2 * left_s**2)
    position_mm = np.where(up, 0.5 * top_mm_s2 * time_s**2, position_mm)
    velocity_mm_s = np.where(up, top_mm_s2 * time_s, np.where(even, feed_mm_s, top_mm_s2 * left_s))
    acceleration_mm_s2 = np.where(up, top_mm_s2, np.where(even, 0, -top_mm_s2))
    return time_s, position_mm, velocity_mm_s, acceleration_mm_s2, total_s


def feed_sweep(rng, name, axis):
    """feed_sweep: strokes to and fro at rising feeds."""
    travel_mm = rng.uniform(40, 600)
    feeds_mm_s = np.sort(10 ** rng.uniform(-1, 1, int(rng.integers(4, 9)))) * 1000 / 60
    top_mm_s2 = rng.uniform(500, 5000)
    parts = []
    begun_s = 0
    for number, feed_mm_s in enumerate(feeds_mm_s, 1):
        rows = int(rng.integers(12, 25))
        if feed_mm_s * (feed_mm_s / top_mm_s2) > travel_mm * 0.8:  # it would not come up to this feed
            feed_mm_s = np.sqrt(0.8 * travel_mm * top_mm_s2)
        for sign in (1, -1):
            time_s, along_mm, mm_s, mm_s2, total_s = stroke(rows, travel_mm, feed_mm_s, top_mm_s2)
            position_mm = along_mm if sign > 0 else travel_mm - along_mm
            parts.append((begun_s + time_s, position_mm, sign * mm_s, sign * mm_s2, np.full(rows, float(number))))
            begun_s += total_s + 1
    time_s, position_mm, velocity_mm_s, acceleration_mm_s2, cycle = map(np.concatenate, zip(*parts))
    record = Record(name, "feed_sweep", len(time_s), cycle=cycle, responses=[f"error.{axis}"])
    record.position_mm[axis] = np.round(position_mm, 4)
    record.velocity_mm_s[axis] = np.round(velocity_mm_s, 4)
    record.acceleration_mm_s2[axis] = np.round(acceleration_mm_s2, 3)
    record.direction[axis] = np.sign(velocity_mm_s)
    record.time_s = np.round(time_s, 4)
    record.menu = [f"following_error.{axis}", f"acceleration_error.{axis}", f"reversal.{axis}", f"scale.{axis}"]
    record.both_ways, record.low_mm, record.travel_mm, record.targets = True, 0, travel_mm, 30
    return record


def loads(rng, name, axis):
    """positioning: an axis at rest is pushed and pulled with some forces."""
    rows = int(rng.integers(60, 160))
    levels_n = rng.uniform(-1, 1, int(rng.integers(5, 10))) * rng.uniform(200, 3000)
    load_n = np.repeat(levels_n, int(np.ceil(rows / len(levels_n))))[:rows]
    record = Record(name, "positioning", rows, time_s=np.arange(rows) * 5.0, responses=[f"error.{axis}"])
    record.load_n[axis] = np.round(load_n + rng.standard_normal(rows) * 2, 1)
    record.position_mm[axis] = np.round(np.full(rows, rng.uniform(0, 500)), 3)
    temperatures(rng, record, np.linspace(0, 0.1, rows), sensors=2, span_k=1)
    record.menu = [f"stiffness.{axis}", f"lost_counts.{axis}"]
    return record


def ring(rng, name, kind="probing"):
    """probing: a ring, touched all round; or part: a round part, its form measured."""
    points = int(rng.integers(36, 181))
    rounds = int(rng.integers(1, 4))
    rounds = max(rounds, int(np.ceil(90 / points)))
    start_rad = rng.uniform(0, 0.01) if rng.random() < 0.5 else 0
    record = Record(name, kind, points * rounds, responses=["error.r"], targets=points)
    record.angle_rad = np.round(np.tile(np.arange(points) * TURN / points, rounds) + start_rad, 5)
    record.cycle = np.repeat(np.arange(1.0, rounds + 1), points)
    record.time_s = np.arange(record.rows) * rng.uniform(1, 4)
    record.time_logged = bool(rng.random() < 0.5)
    record.menu = ["probe_lobing", "form_bump"] if kind == "probing" else ["form_bump"]
    return record


def touches(rng, name, axis):
    """probing: the same few faces, touched from both sides at several speeds."""
    speeds_mm_s = 10 ** rng.uniform(0, 2, int(rng.integers(4, 8)))
    cycles = int(rng.integers(5, 10))
    once_mm_s = np.concatenate([(speed, -speed) for speed in speeds_mm_s])
    velocity_mm_s = np.tile(once_mm_s, cycles)
    rows = len(velocity_mm_s)
    record = Record(name, "probing", rows, time_s=np.arange(rows) * 4.0, responses=[f"error.{axis}"])
    record.position_mm[axis] = np.array([rng.choice([0, 20.0, 50.0]) for _ in range(rows)])
    record.velocity_mm_s[axis] = np.round(velocity_mm_s, 3)
    record.direction[axis] = np.sign(velocity_mm_s)
    record.cycle = np.repeat(np.arange(1.0, cycles + 1), len(once_mm_s))
    record.menu = [f"probe_latency.{axis}", f"reversal.{axis}"]
    return record


def fine_line(rng, name, axis):
    """positioning: some periods of the scale's signals, in small steps."""
    period_um = float(rng.choice([2, 4, 10, 20, 40, 100, 200]))
    rows = int(rng.integers(120, 300))
    periods = rng.uniform(3, 12)
    position_mm = rng.uniform(0, 300) + np.linspace(0, periods * period_um / 1000, rows)
    record = Record(name, "positioning", rows, time_s=np.arange(rows) * 1.0, responses=[f"error.{axis}"])
    record.position_mm[axis] = np.round(position_mm, 6)
    record.direction[axis] = np.ones(rows)
    record.period_um = period_um
    record.menu = [f"subdivision.{axis}"]
    return record


def forces(rng, name, axis):
    """dynamics: the drive's force over strokes with ramps."""
    rows = int(rng.integers(200, 600))
    step_s = 0.01
    strokes = int(rng.integers(4, 8))
    length = rows // strokes
    velocity_mm_s = np.zeros(rows)
    for i in range(strokes):
        feed_mm_s = rng.uniform(20, 400) * (1 if i % 2 == 0 else -1)
        along = np.linspace(0, 1, length)
        ramps = np.clip(np.minimum(along, 1 - along) / rng.uniform(0.15, 0.4), 0, 1)
        velocity_mm_s[i * length:(i + 1) * length] = feed_mm_s * ramps
    velocity_mm_s = velocity_mm_s + 0.0  # no negative zeros
    record = Record(name, "dynamics", rows, responses=[f"force.{axis}"])
    record.velocity_mm_s[axis] = np.round(velocity_mm_s, 3)
    record.acceleration_mm_s2[axis] = np.round(np.gradient(velocity_mm_s, step_s), 1)
    record.position_mm[axis] = np.round(np.cumsum(velocity_mm_s) * step_s, 4)
    record.time_s = np.round(np.arange(rows) * step_s, 3)
    kinds = ("inertia", "friction_viscous", "friction_coulomb", "friction_asymmetric", "force_offset")
    record.menu = [f"{kind}.{axis}" for kind in kinds]
    return record


# --- files -------------------------------------------------------------------------------------------------------


def columns(record):
    """Name, role, unit and values of each column of the file."""
    out = []
    if record.time_logged:
        out.append(("t", "time", "s", record.time_s))
    if record.cycle is not None:
        out.append(("n", "cycle", "1", record.cycle))
    by_axis = (("", "position", "mm"), ("d_", "direction", "1"), ("v_", "velocity", "mm/s"),
               ("a_", "acceleration", "mm/s2"), ("F_", "load", "N"))
    of_axes = (record.position_mm, record.direction, record.velocity_mm_s, record.acceleration_mm_s2, record.load_n)
    for (prefix, role, unit), values in zip(by_axis, of_axes):
        out += [(prefix + axis, f"{role}.{axis}", unit, values[axis]) for axis in values]
    out += [(sensor, "temperature", "degC", degc) for sensor, degc in record.logged_degc.items()]
    for name, role, unit, values in (("rpm", "spindle_speed", "rpm", record.spindle_rpm),
                                     ("wet", "coolant", "1", record.coolant),
                                     ("ang", "angle", "rad", record.angle_rad)):
        if values is not None:
            out.append((name, role, unit, values))
    out += [(channel, "channel", "1", values) for channel, values in record.channel.items()]
    for response in record.responses:
        unit = "N" if response.startswith("force") else "um"
        out.append((response.replace(".", "_"), response, unit, record.error[response]))
    return out


def write_record(folder, record):
    """NAME.csv and NAME.run.toml."""
    heads = columns(record)
    with open(folder / f"{record.name}.csv", "w", encoding="utf-8") as file:
        file.write(",".join(head[0] for head in heads) + "\n")
        for row in np.array([head[3] for head in heads], float).T:
            file.write(",".join(f"{value:.10g}" for value in row) + "\n")
    with open(folder / f"{record.name}.run.toml", "w", encoding="utf-8") as file:
        file.write(f'file = "{record.name}.csv"\nkind = "{record.kind}"\n')
        if record.count_um:
            file.write(f"count_um = {record.count_um}\n")
        if record.radius_mm and "error.r" in record.responses:
            file.write(f"radius_mm = {record.radius_mm}\nplane = {json.dumps(record.plane)}\n")
        if record.zero:
            file.write(f'zero = "{record.zero}"\n')
        file.write("[columns]\n")
        for name, role, unit, _ in heads:
            file.write(f'{name} = {{ role = "{role}", unit = "{unit}" }}\n')


def toml_value(value):
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    return repr(float(value))


def write_model(path, effects):
    with open(path, "w", encoding="utf-8") as file:
        file.write('name = "m"\n')
        for effect in effects:
            file.write("\n[[effect]]\n")
            for key, value in effect.items():
                file.write(f"{key} = {toml_value(value)}\n")
