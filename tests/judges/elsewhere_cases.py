"""Blind cases for `elsewhere.py`, of each of its classes: measurements, what the model lacks, and what a gauge reads.

What a class is stands in `elsewhere.py`. Each `case_CLASS` gives a case, or None where a seed leads to none.
"""

import copy
from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np

import elsewhere_records as makes
from elsewhere_records import FORCES, KINDS, NOT_NEGATIVE, ROUND, TURN, Seen, contribution, kind_of, scaled

# --- effects that are drawn --------------------------------------------------------------------------------------


@dataclass
class Case:
    records: list
    sigma: dict  # noise by quantity: error in um, force in N
    correlation: float  # of the noise, from row to row
    walk: float  # a walk as large as so many of the noise by its end
    zeros: dict = field(default_factory=dict)  # by (name of the zero, response)
    hidden: list = field(default_factory=list)  # effects that the model lacks
    known: list = field(default_factory=list)  # effects that it has, as they are
    given: list = field(default_factory=list)  # the same, as the model has them
    strength: float = 0.0  # of the weakest hidden effect, in the noise
    stranger: object = None  # of a record and a response, what no law has
    stranger_name: str = None
    holdouts: list = field(default_factory=list)
    mistake: str = None
    mistaken: list = field(default_factory=list)  # what takes the place of the records or hold-outs

    def noise(self, response):
        return self.sigma[response.split(".")[0]]


def smooth_line(rng, low_mm, high_mm, knots):
    knots_mm = np.linspace(low_mm, high_mm, knots)
    along = (knots_mm - low_mm) / (high_mm - low_mm)
    um = sum(rng.standard_normal() / (j**1.2) * np.sin(np.pi * j * along + rng.uniform(0, 6)) for j in range(1, 6))
    return knots_mm, um


def draw_line(rng, effect, records, able, knots):
    """A map's knots over all that is gone through, without offset and slope: those are other effects."""
    kind, axis, *rest = effect["name"].split(".")
    along = rest[0] if rest else axis
    shows = {f"error.{axis}", "error.r"}
    seen = [r.position_mm[along] for r in records if along in r.position_mm and shows & set(r.responses)]
    places_mm = np.concatenate(seen)
    targets = min([len(np.unique(np.round(r.position_mm[along], 1))) for r in able] or [9])
    knots = knots or int(rng.integers(5, max(6, min(12, targets // 2 + 1))))
    knots_mm, um = smooth_line(rng, places_mm.min() - 1e-6, places_mm.max() + 1e-6, knots)
    um = um - np.polyval(np.polyfit(places_mm, np.interp(places_mm, knots_mm, um), 1), knots_mm)
    return {**effect, "knots_mm": [round(float(mm), 4) for mm in knots_mm], "um": [float(each) for each in um]}


def draw_thermal(rng, effect, record, sign):
    kind = kind_of(effect)
    sensor = str(rng.choice(record.hot)) if record.hot else record.room
    effect["sensor"] = sensor
    which = rng.random()
    if which < 0.5 and record.room != sensor:
        effect["minus"] = record.room
    elif which < 0.75:
        effect["reference_degC"] = round(float(rng.uniform(18, 24)), 1)
    if kind == "thermal_expansion":
        return {**effect, "ppm_per_K": float(sign)}
    span_k = np.ptp(Seen(effect, record, None, False).delta_k())
    effect["um_per_K"] = float(sign)
    effect["um_per_K2"] = 0.0
    if rng.random() < 0.35:
        effect["um_per_K2"] = float(sign * rng.choice([-1, 1]) * rng.uniform(0.1, 0.5) / max(span_k, 1))
    if kind == "thermal_lag":
        length_s = record.time_s[-1] - record.time_s[0]
        step_s = np.median(np.diff(record.time_s))
        effect["tau_s"] = float(max(30, 4 * step_s, length_s * 10 ** rng.uniform(-1.7, -0.7)))
    return effect


def draw_screw(rng, effect, record):
    if record.kind == "ballbar":
        period_mm = float(rng.choice([5, 10, 12, 16, 20, 25.4]))
    else:
        step_mm = record.travel_mm / record.targets
        period_mm = float(min(60, max(2.2 * step_mm, rng.choice([5, 10, 16, 20, 40])))) * rng.uniform(0.97, 1.0)
        if period_mm < 2.1 * step_mm:  # its targets would not show it
            return None
    return {**effect, "um": 1.0, "period_mm": round(period_mm, 3), "phase_rad": float(rng.uniform(-3, 3))}


def draw_spindle_speed(rng, effect, sign):
    return {**effect, "um_per_krpm": float(sign),
            "um_per_krpm2": float(sign * rng.uniform(0.02, 0.1)) if rng.random() < 0.5 else 0.0}


def draw(rng, name, records, knots=None):
    """An effect of this name that these records can show, of unit size; None where they cannot."""
    kind = kind_of(name)
    effect = {"name": name}
    able = [r for r in records if name in r.menu]
    record = next((r for r in able if r.hot), able[0] if able else records[0])
    sign = 1 if kind in NOT_NEGATIVE else rng.choice([-1, 1])
    size = {**effect, "um": float(sign)}
    unit = {**effect, "um": 1.0}
    if kind in ("position_map", "straightness"):
        return draw_line(rng, effect, records, able, knots)
    if kind.startswith("thermal"):
        return draw_thermal(rng, effect, record, sign)
    if kind == "warm_up":
        return {**size, "tau_s": float(max(30, record.time_s[-1] * rng.uniform(0.08, 0.5)))}
    if kind == "screw_periodic":
        return draw_screw(rng, effect, record)
    if kind == "subdivision":
        return {**unit, "period_um": record.period_um, "phase_rad": float(rng.uniform(-3, 3))}
    if kind == "reversal_spike":
        return {**size, "length_mm": round(float(10 ** rng.uniform(-0.2, 1.0)), 3)}
    if kind == "lost_counts":
        row = int(rng.uniform(0.15, 0.85) * record.rows)
        return {**size, "at_s": round(float(record.time_s[row] - 1e-3), 3)}
    if kind == "probe_lobing":
        return {**unit, "lobes": float(rng.choice([2, 3, 4, 5, 6])), "phase_rad": float(rng.uniform(-3, 3))}
    if kind == "form_bump":
        return {**size, "centre_rad": float(rng.uniform(0, 6.2)), "width_rad": float(rng.uniform(0.3, 2.5))}
    if kind == "spindle_speed":
        return draw_spindle_speed(rng, effect, sign)
    return {**effect, KINDS[kind].sizes[0]: float(sign)}


# --- how large an effect is, by least squares --------------------------------------------------------------------


def stack(case, function):
    """A function of record and response over all rows, in the noise."""
    parts = [function(r, response) / case.noise(response) for r in case.records for response in r.responses]
    return np.concatenate(parts)


def stacked(case, effect, logged=False):
    return stack(case, lambda r, response: contribution(effect, r, response, logged))


def free(case, others=()):
    """What takes its own size in any fit: known effects, zeros of gauges, others."""
    out = [stacked(case, effect) for effect in [*case.known, *others]]
    zeros = dict.fromkeys((r.zero, response) for r in case.records if r.zero for response in r.responses)
    for zero in zeros:
        out.append(stack(case, lambda r, response: np.full(r.rows, float((r.zero, response) == zero))))
    rows = sum(r.rows * len(r.responses) for r in case.records)
    return np.array(out).T if out else np.zeros((rows, 0))


def left_of(values, matrix):
    """What of the values the columns of the matrix do not take."""
    norms = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, norms > 1e-12] / norms[norms > 1e-12]
    if matrix.shape[1] == 0:
        return values
    return values - matrix @ np.linalg.lstsq(matrix, values, rcond=1e-9)[0]


def strength(case, effect, others=()):
    """Root mean square, in the noise, of what nothing else takes of the effect, over the responses that show it."""
    values = stacked(case, effect)
    shown = stack(case, lambda r, s: np.full(r.rows, case.noise(s) * np.any(contribution(effect, r, s) != 0))) != 0
    if kind_of(effect) == "form_bump":
        shown = values != 0
    if not shown.any():
        return 0
    return np.sqrt(np.mean(left_of(values, free(case, others))[shown] ** 2))


def sized(case, effect, wanted, others=()):
    """The effect at this strength; None where no machine has it so large."""
    kind = kind_of(effect)
    now = strength(case, effect, others)
    if now < 1e-9:
        return None
    effect = scaled(effect, wanted / now)
    if kind == "lost_counts":
        count_um = case.records[0].count_um or 1.0
        counts = max(1, round(abs(effect["um"]) / count_um))
        effect["um"] = float(np.sign(effect["um"]) * counts * count_um)
    largest = np.max(np.abs(effect[KINDS[kind].sizes[0]]))
    if largest > 0.8 * KINDS[kind].largest:
        return None
    if kind == "subdivision" and largest > effect["period_um"] / 4 * 0.9:
        return None
    return effect


# --- cases -------------------------------------------------------------------------------------------------------


def begin(rng, records):
    sigma = {"error": float(10 ** rng.uniform(-1.2, 0.5)), "force": float(10 ** rng.uniform(-0.5, 1.3))}
    case = Case(records, sigma, float(rng.choice([0, 0, 0, 0.2, 0.45])), float(rng.choice([0, 0, 0.1, 0.2])))
    if len(records) > 1 and rng.random() < 0.5:
        for record in records:
            record.zero = "set_" + record.name
    for record in records:  # noise of a machine is no smaller than half a count
        record.count_um = float(max(um for um in (0.01, 0.1, 0.5, 1, 2) if um <= 2 * sigma["error"]))
    return case


def know(rng, case, avoided, most=4):
    """What the model holds already, each some 10 % off."""
    menu = sorted({name for r in case.records for name in r.menu} - set(avoided))
    rng.shuffle(menu)
    seldom = {"lost_counts", "form_bump", "offset", "channel", "warm_up", "thermal_lag", "subdivision", "probe_lobing"}
    for name in menu:
        if len(case.known) >= rng.integers(0, most + 1):
            break
        kind = kind_of(name)
        if kind in seldom and rng.random() < 0.8:
            continue
        if kind == "rotation" and any("squareness" in other for other in avoided):
            continue
        knots = int(rng.choice([5, 9, 60])) if kind in ("position_map", "straightness") else None
        if kind == "position_map" and any("screw" in other for other in avoided):
            continue
        effect = draw(rng, name, case.records, knots)
        effect = effect and sized(case, effect, 10 ** rng.uniform(0.3, 1.5))
        if not effect or kind == "lost_counts":
            continue
        case.known.append(effect)
        case.given.append(scaled(effect, 1 + np.clip(0.1 * rng.standard_normal(), -0.2, 0.2)))


def noise_of(rng, rows, correlation):
    white = rng.standard_normal(rows)
    if correlation == 0:
        return white
    out = white.copy()
    for i in range(1, rows):
        out[i] = correlation * out[i - 1] + np.sqrt(1 - correlation**2) * white[i]
    return out


def measure(rng, case):
    """The errors, as a gauge reads them."""
    for record in case.records:
        record.error = {}
        for response in record.responses:
            effects = case.known + case.hidden
            value = sum((contribution(effect, record, response) for effect in effects), np.zeros(record.rows))
            if case.stranger:
                value = value + case.stranger(record, response)
            sigma = case.noise(response)
            value = value + sigma * noise_of(rng, record.rows, case.correlation)
            if case.walk:
                value = value + sigma * case.walk * np.cumsum(rng.standard_normal(record.rows)) / np.sqrt(record.rows)
            if record.zero:
                value = value + case.zeros.setdefault((record.zero, response), float(rng.normal(0, 5 * sigma)))
            step = 10.0 ** np.floor(np.log10(sigma / 5))
            record.error[response] = np.round(value / step) * step


def measurements(rng):
    """What somebody measures in one go."""
    which = rng.integers(12)
    axis = str(rng.choice(["x", "y", "z"]))
    other = str(rng.choice([each for each in "xyz" if each != axis]))
    single = {
        0: lambda: makes.line(rng, "lin", axis),
        1: lambda: makes.line(rng, "lin", axis, cross=other),
        2: lambda: makes.line(rng, "warm", axis, warm=True),
        3: lambda: makes.lines_apart(rng, "off", axis, other),
        4: lambda: makes.plate(rng, "plate"),
        5: lambda: makes.ballbar(rng, "bb", *(("x", "y") if rng.random() < 0.6 else ("z", "x"))),
        6: lambda: makes.ballbar(rng, "bb", radial=True),
        7: lambda: makes.drift(rng, "drift"),
        8: lambda: makes.drift(rng, "drift"),
        9: lambda: makes.feed_sweep(rng, "feed", axis),
    }
    if which in single:
        return [single[which]()]
    if which == 10:
        feed_mm_s = rng.uniform(5, 20)
        radius_mm = float(rng.choice([100, 150]))
        slow = makes.ballbar(rng, "slow", radius_mm=radius_mm, feed_mm_s=feed_mm_s)
        fast = makes.ballbar(rng, "fast", radius_mm=radius_mm, feed_mm_s=feed_mm_s * rng.uniform(4, 9))
        for record in (slow, fast):
            record.menu += ["acceleration_error.x", "acceleration_error.y"]
        return [slow, fast]
    travel_mm = 10 ** rng.uniform(2, 3.3)
    x = makes.line(rng, "lx", "x", travel_mm=travel_mm, low_mm=0)
    y = makes.line(rng, "ly", "y", travel_mm=travel_mm * rng.uniform(0.3, 1), low_mm=0)
    return [x, y, makes.ballbar(rng, "bb", radius_mm=float(rng.choice([50, 100])))]


SPECIAL = {"stiffness": makes.loads, "probe_latency": makes.touches, "subdivision": makes.fine_line}


def special(rng, kind):
    """The measurement that shows this kind of effect, and hardly another."""
    axis = str(rng.choice(["x", "y", "z"]))
    if kind in SPECIAL:
        return [SPECIAL[kind](rng, kind, axis)]
    if kind == "probe_lobing":
        return [makes.ring(rng, "ring")]
    if kind == "form_bump":
        return [makes.ring(rng, "part", str(rng.choice(["part", "probing"])))]
    return [makes.forces(rng, "dyn", axis)]


def without_zeros(records):
    for record in records:
        record.zero = None


def of_all(records):
    return sorted({name for r in records for name in r.menu})


def case_one(rng, seed):
    kind = sorted(KINDS)[seed % len(KINDS)]
    if kind == "offset":
        return None  # the zero of a record's gauges, by the contract: not to be told from the machine's
    for _ in range(200):
        records = special(rng, kind) if kind in SPECIAL or kind in ROUND or kind in FORCES else measurements(rng)
        names = [name for name in of_all(records) if kind_of(name) == kind]
        if not names:
            continue
        name = str(rng.choice(names))
        case = begin(rng, records)
        if kind == "force_offset":
            without_zeros(records)
        know(rng, case, [name])
        effect = draw(rng, name, records)
        effect = effect and sized(case, effect, 10 ** rng.uniform(np.log10(0.7), 1))
        if not effect:
            continue
        case.strength = strength(case, effect)
        shown = [np.any(contribution(effect, r, response) != 0) * r.rows for r in records for response in r.responses]
        if not 0.65 < case.strength < 11:
            continue
        if case.strength**2 * sum(shown) * (1 - case.correlation) / (1 + case.correlation) < 60:
            continue
        case.hidden = [effect]
        measure(rng, case)
        return case
    return None


def case_nothing(rng, seed):
    shown = ["stiffness", "probe_latency", "subdivision", "probe_lobing", "form_bump", "inertia"]
    records = measurements(rng) if rng.random() < 0.8 else special(rng, str(rng.choice(shown)))
    case = begin(rng, records)
    know(rng, case, [])
    measure(rng, case)
    return case


def case_two(rng, seed):
    for _ in range(300):
        usual = rng.random() < 0.85
        records = measurements(rng) if usual else special(rng, str(rng.choice(["probe_lobing", "inertia"])))
        case = begin(rng, records)
        if len(of_all(records)) < 2:
            continue
        names = [str(name) for name in rng.choice(of_all(records), 2, replace=False)]
        kinds = {kind_of(name) for name in names}
        if "offset" in kinds:
            continue  # as in `case_one`
        if kinds in ({"rotation", "squareness"}, {"warm_up", "thermal_lag"}):
            continue
        know(rng, case, names, 3)
        a, b = [draw(rng, name, records) for name in names]
        if not a or not b:
            continue
        a = sized(case, a, 10 ** rng.uniform(np.log10(3), 1), [b])
        b = a and sized(case, b, 10 ** rng.uniform(np.log10(3), 1), [a])
        if not a or not b:
            continue
        own = strength(case, a, [b]), strength(case, b, [a])
        # Nor is one grown large because the other nearly looks like it.
        if min(own) < 2.9 or strength(case, a) > 4 * own[0] or strength(case, b) > 4 * own[1]:
            continue
        case.strength = min(own)
        case.hidden = [a, b]
        measure(rng, case)
        return case
    return None


# --- strangers ---------------------------------------------------------------------------------------------------


def one_of(rng, shapes):
    names = list(shapes)
    name = names[rng.integers(len(names))]
    return name, shapes[name]


def bell(values, middle, width):
    return np.exp(-0.5 * ((values - middle) / width) ** 2)


def stranger_of_drift(rng, record, axis):
    sensor = record.hot[0] if record.hot else record.room
    middle_degc = np.quantile(record.true_degc[sensor], rng.uniform(0.35, 0.65))
    span_k = np.ptp(record.true_degc[sensor])
    length_s = record.time_s[-1]

    def waves(r):
        return np.sin(TURN * (4 * (r.time_s / length_s) + 9 * (r.time_s / length_s) ** 2))

    name, shape = one_of(rng, {
        "step_at_T": lambda r: (r.true_degc[sensor] > middle_degc) * 1.0,
        "chirp_t": waves,
        "bumps_t": lambda r: sum(bell(r.time_s / length_s, middle, 0.025) for middle in (0.2, 0.45, 0.8)),
        "wave_of_T": lambda r: np.sin(TURN * (r.true_degc[sensor] - middle_degc) / (0.22 * span_k)),
        "wet_times_rpm_wave": lambda r: r.coolant * np.sin(TURN * 6 * r.time_s / length_s),
    })
    # A step that is passed once could be lost counts.
    return None if name == "step_at_T" and np.sum(np.diff(shape(record)) != 0) < 2 else (name, shape)


def stranger_of_plate(rng, record, axis):
    def along(r, place):
        axis = record.responses[place].split(".")[1]
        low_mm, length_mm = record.extent[axis]
        return (r.position_mm[axis] - low_mm) / length_mm

    return one_of(rng, {
        "sinx_siny": lambda r: np.sin(TURN * along(r, 0)) * np.sin(TURN * along(r, 1)),
        "bump_xy": lambda r: np.exp(-((along(r, 0) - 0.4) ** 2 + (along(r, 1) - 0.6) ** 2) / 0.04),
        "saddle3": lambda r: (along(r, 0) - 0.5) ** 2 * (along(r, 1) - 0.5) * 8,
    })


def stranger_of_line(rng, record, axis):
    if not record.both_ways:
        return None

    def along(r):
        return (r.position_mm[axis] - record.low_mm) / record.travel_mm

    return one_of(rng, {
        "dir_times_p": lambda r: r.direction[axis] * (along(r) - 0.5),
        "dir_wave": lambda r: r.direction[axis] * np.sin(TURN * 1.5 * along(r)),
        "dir_bump": lambda r: r.direction[axis] * bell(along(r), 0.4, 0.08),
        "growing_wave_t": lambda r: along(r) * np.sin(TURN * 9 * r.time_s / r.time_s[-1]),
    })


def stranger_of_ballbar(rng, record, axis):
    def bump(r, rad):
        return np.exp(-0.5 * (((r.angle_rad - rad) % TURN - 1) / 0.25) ** 2)

    def velocities(r):
        a, b = (r.velocity_mm_s[each] for each in r.plane)
        return a * b * np.sign(a)

    along_radius = one_of(rng, {
        "dir_wave_angle": lambda r: np.where(r.cycle == 1, 1.0, -1.0) * np.sin(5 * r.angle_rad + 1),
        "way_bump": lambda r: (r.cycle == 1) * (bump(r, 1) - bump(r, 4)),
    })
    if "error.r" in record.responses:
        return along_radius
    if rng.random() < 0.4:
        return "xy_wave", lambda r: np.sin(3 * r.angle_rad + 0.7) * np.cos(2 * r.angle_rad) * np.sin(r.angle_rad + 1.9)
    return "vxy", velocities


def stranger_of_feeds(rng, record, axis):
    return one_of(rng, {
        "v_squared": lambda r: r.velocity_mm_s[axis] ** 2,
        "abs_v": lambda r: abs(r.velocity_mm_s[axis]),
        "sqrt_v_signed": lambda r: np.sign(r.velocity_mm_s[axis]) * np.sqrt(abs(r.velocity_mm_s[axis])),
        "v_times_p": lambda r: r.velocity_mm_s[axis] * r.position_mm[axis],
    })


def stranger_of_ring(rng, record, axis):
    return one_of(rng, {
        "chirp_angle": lambda r: np.sin(1.2 * r.angle_rad**2),
        "square_steps": lambda r: np.sign(np.sin(3 * r.angle_rad + 0.4)) * (r.angle_rad % TURN > 2),
        "saw": lambda r: ((r.angle_rad * 2.5 / TURN) % 1) - 0.5,
    })


STRANGERS = {"drift": stranger_of_drift, "plate": stranger_of_plate, "positioning": stranger_of_line,
             "ballbar": stranger_of_ballbar, "feed_sweep": stranger_of_feeds, "probing": stranger_of_ring}


def case_stranger(rng, seed):
    for _ in range(100):
        records = measurements(rng) if rng.random() < 0.9 else [makes.ring(rng, "ring")]
        case = begin(rng, records)
        know(rng, case, [], 2)
        first = records[0]
        drawn = STRANGERS[first.kind](rng, first, first.responses[0].split(".")[1])
        if not drawn:
            continue
        case.stranger_name, shape = drawn
        mean = float(np.mean(shape(first)))
        same = [r for r in records if r is first or (r.kind == first.kind and len(records) == 2)]

        def alone(r, response):
            there = response == first.responses[0] and any(r is each for each in same)
            return shape(r) - mean if there else np.zeros(r.rows)

        values = stack(case, alone)
        # No offset shall be told from it.
        levels = [stack(case, lambda r, response: np.ones(r.rows) * (response == level))
                  for level in sorted({response for r in records for response in r.responses})]
        own = left_of(values, np.column_stack([free(case)] + levels))[values != 0]
        size = np.sqrt(np.mean(own**2))
        if size < 1e-6:
            continue
        case.strength = 10 ** rng.uniform(np.log10(3), 1)
        factor = case.strength / size
        case.stranger = lambda r, response: factor * alone(r, response)
        measure(rng, case)
        return case
    return None


# --- many effects, and hold-outs ---------------------------------------------------------------------------------


def share_sensors(rng, record, drifts):
    """A short measurement beside a drift has its sensors, which hardly move meanwhile."""
    record.true_degc, record.logged_degc = {}, {}
    if not drifts:
        return
    room_degc = rng.uniform(19, 22)
    time_s = record.time_s - record.time_s[0]
    for sensor in drifts[0].true_degc:
        degc = room_degc + rng.uniform(-0.3, 0.3) + rng.uniform(0.05, 0.4) * time_s / max(time_s[-1], 1)
        record.true_degc[sensor] = degc
        record.logged_degc[sensor] = np.round(degc + 0.008 * rng.standard_normal(record.rows), 3)
    record.room, record.hot = drifts[0].room, []


def several(rng):
    travel_mm = 10 ** rng.uniform(2.1, 3.4)
    records = []
    kinds = rng.permutation(["lx", "ly", "lz", "bb", "plate", "drift", "feed"])
    for kind in list(kinds)[:int(rng.integers(2, 5))]:
        if kind[0] == "l":
            own_mm = travel_mm * rng.uniform(0.4, 1)
            crossed = rng.random() < 0.35
            cross = str(rng.choice([axis for axis in "xyz" if axis != kind[1]])) if crossed else None
            records.append(makes.line(rng, str(kind), kind[1], travel_mm=own_mm, low_mm=0, cross=cross))
        elif kind == "bb":
            records.append(makes.ballbar(rng, "bb"))
        elif kind == "plate":
            records.append(makes.plate(rng, "plate"))
        elif kind == "drift":
            records.append(makes.drift(rng, "drift"))
        else:
            records.append(makes.feed_sweep(rng, "feed", str(rng.choice(["x", "y", "z"]))))
    return records


# Of each of these a machine has one at a time; the second value: over all axes, or of one.
ONE_OF = [({"warm_up", "thermal_lag", "thermal_growth"}, False), ({"rotation", "squareness"}, True),
          ({"position_map", "screw_periodic"}, False)]


def goes_beside(name, names):
    for kinds, of_any_axis in ONE_OF:
        if kind_of(name) not in kinds:
            continue
        for other in names:
            if kind_of(other) in kinds and (of_any_axis or other.split(".")[1] == name.split(".")[1]):
                return False
    return True


def later(rng, record):
    """The same measurement on another day, at other places; None where it has none."""
    name = "hold_" + record.name
    if record.kind == "positioning":
        axis, *cross = [response.split(".")[1] for response in record.responses]
        return makes.line(rng, name, axis, record.travel_mm, cross[0] if cross else None, low_mm=record.low_mm)
    if record.kind == "ballbar":
        feed_mm_s = record.feed_mm_s * rng.uniform(0.7, 1.3)
        return makes.ballbar(rng, "hold_bb", radius_mm=record.radius_mm, feed_mm_s=feed_mm_s)
    if record.kind != "plate":
        return None
    out = copy.deepcopy(record)
    out.name = name
    for axis, mm in out.position_mm.items():
        out.position_mm[axis] = np.round(mm * 0.93 + rng.uniform(0, 0.03) * np.ptp(mm), 3)
    return out


def hold_out(rng, case, drifts):
    for record in case.records:
        holdout = later(rng, record)
        if holdout:
            share_sensors(rng, holdout, drifts)
            holdout.zero, holdout.count_um = record.zero, record.count_um
            case.holdouts.append(holdout)
    if case.holdouts:
        other = copy.copy(case)
        other.records = case.holdouts
        measure(rng, other)


def case_many(rng, seed):
    for _ in range(300):
        records = several(rng)
        drifts = [r for r in records if r.kind == "drift"]
        for record in drifts:
            record.menu = [name for name in record.menu if not name.startswith("channel")]
            record.channel = {}
        for record in records:
            if record.kind != "drift":
                share_sensors(rng, record, drifts)
        case = begin(rng, records)
        menu = [name for name in of_all(records) if kind_of(name) not in ("offset", "lost_counts")]
        if len(menu) < 4:
            continue
        wanted = int(rng.integers(3, 8))
        rng.shuffle(menu)
        hidden = []
        for name in menu:
            if len(hidden) >= wanted:
                break
            if not goes_beside(name, [effect["name"] for effect in hidden]):
                continue
            effect = draw(rng, name, records)
            effect = effect and sized(case, effect, 10 ** rng.uniform(0.2, 1.1))
            if effect:
                hidden.append(effect)
        if len(hidden) < 3:
            continue
        own = [strength(case, effect, [other for other in hidden if other is not effect]) for effect in hidden]
        if min(own) < 1.2 or any(strength(case, effect) > 5 * each for effect, each in zip(hidden, own)):
            continue
        case.hidden, case.strength = hidden, min(own)
        measure(rng, case)
        hold_out(rng, case, drifts)
        return case
    return None


# --- mistakes ----------------------------------------------------------------------------------------------------


def thermal_sensor(case):
    return next(effect["sensor"] for effect in case.known if "sensor" in effect)


def times(values, key, factor, plus=0):
    values[key] = values[key] * factor + plus


def exchange(values, a, b):
    values[a], values[b] = values[b], values[a]


# Each changes the record as it is logged; False where this record would not show it.
def all_errors(factor):
    def mistake(rng, case, record):
        for response in record.responses:
            times(record.error, response, factor)
    return mistake


def one_position(factor):
    return lambda rng, case, record: times(record.position_mm, record.responses[0][6:], factor)


def one_temperature(factor, plus):
    return lambda rng, case, record: times(record.logged_degc, thermal_sensor(case), factor, plus)


def in_minutes(rng, case, record):
    record.time_s = record.time_s * (1 / 60.0)


def per_second(rng, case, record):
    record.spindle_rpm = record.spindle_rpm * (1 / 60.0)


def sign(rng, case, record):
    times(record.error, record.responses[0], -1)


def direction(rng, case, record):
    times(record.direction, record.responses[0][6:], -1)


def swapped_positions(rng, case, record):
    exchange(record.position_mm, *list(record.position_mm))


def swapped_errors(rng, case, record):
    exchange(record.error, *record.responses)


def swapped_sensors(rng, case, record):
    sensor = thermal_sensor(case)
    other = ([each for each in record.hot if each != sensor] + [record.room])[0]
    if np.std(record.true_degc[other] - record.true_degc[sensor]) < 1.5:
        return False
    exchange(record.logged_degc, sensor, other)
    return True


def doubled(rng, case, record):
    """Some rows stand twice; in their order where there is a time."""
    length = int(rng.integers(5, 25))
    start = int(rng.integers(0, record.rows - length))
    rows = np.r_[np.arange(0, start + length), np.arange(start, record.rows)]
    rows = np.sort(rows) if record.time_logged else rows
    record.rows = len(rows)
    for key, value in vars(record).items():
        if isinstance(value, np.ndarray):
            setattr(record, key, value[rows])
        elif isinstance(value, dict) and key != "extent":
            setattr(record, key, {each: column[rows] for each, column in value.items()})


def unplugged(rng, case, record):
    degc = rng.choice([-273.15, -200.0, 850.0, 1372.0, -50.0, 0.0, 3276.7])
    record.logged_degc[thermal_sensor(case)][int(rng.integers(0, record.rows // 2)):] = degc


def stuck_sensor(rng, case, record):
    sensor = thermal_sensor(case)
    start = int(rng.integers(record.rows // 6, record.rows // 2))
    if np.ptp(record.true_degc[sensor][start:]) < 3:
        return False
    record.logged_degc[sensor][start:] = record.logged_degc[sensor][start]
    return True


def stuck_gauge(rng, case, record):
    values = record.error[record.responses[0]]
    start = int(rng.integers(record.rows // 6, record.rows // 2))
    values[start:start + record.rows // 4] = values[start]


def wild_rows(rng, case, record):
    values = record.error[record.responses[0]]
    count = int(rng.integers(1, 5))
    rows = rng.choice(record.rows, count, replace=False)
    values[rows] += rng.choice([-1, 1], count) * rng.uniform(15, 200, count) * np.std(values)


def decimal_of_sensor(rng, case, record):
    row = rng.integers(record.rows)
    record.logged_degc[thermal_sensor(case)][row] *= rng.choice([0.1, 10])


def decimal_of_position(rng, case, record):
    values = record.position_mm[record.responses[0][6:]]
    row = rng.choice(np.where(abs(values) > 0.3 * np.max(abs(values)))[0])
    values[row] *= rng.choice([0.1, 10])


# What is wrong, which known effect it takes to be seen (the beginning of its name), and how it is done.
Mistake = namedtuple("Mistake", "needs done")
MISTAKES = {
    "error_mm": Mistake("", all_errors(1e-3)),
    "error_nm": Mistake("", all_errors(1e3)),
    "pos_m": Mistake("scale", one_position(1e-3)),
    "pos_inch": Mistake("scale", one_position(1 / 25.4)),
    "T_degF": Mistake("thermal", one_temperature(1.8, 32)),
    "T_K": Mistake("thermal", one_temperature(1, 273.15)),
    "t_min": Mistake("thermal_lag", in_minutes),
    "sign": Mistake("", sign),
    "swap_pos": Mistake("scale", swapped_positions),
    "swap_err": Mistake("scale", swapped_errors),
    "swap_T": Mistake("thermal", swapped_sensors),
    "dir_flip": Mistake("reversal", direction),
    "doubled": Mistake("", doubled),
    "unplugged": Mistake("thermal", unplugged),
    "stuck_T": Mistake("thermal", stuck_sensor),
    "wild": Mistake("", wild_rows),
    "decimal_T": Mistake("thermal", decimal_of_sensor),
    "decimal_p": Mistake("scale", decimal_of_position),
    "other_machine": Mistake("", None),
    "stuck_e": Mistake("", stuck_gauge),
    "rpm_hz": Mistake("spindle", per_second),
}
NEED_SIZE = ("error_mm", "error_nm", "sign", "stuck_e")  # only a large error shows these
SEEN_IN_FIT = ("pos_m", "pos_inch", "t_min", "sign", "swap_pos", "swap_err", "swap_T", "dir_flip", "rpm_hz")


def measured_wrong(rng, kind):
    axis = str(rng.choice(["x", "y", "z"]))
    other = str(rng.choice([each for each in "xyz" if each != axis]))
    if MISTAKES[kind].needs[:7] in ("thermal", "spindle"):
        return [makes.drift(rng, "drift")]
    if kind in ("swap_pos", "swap_err"):
        return [makes.plate(rng, "plate")] if rng.random() < 0.6 else [makes.ballbar(rng, "bb")]
    if MISTAKES[kind].needs:
        alone = rng.random() < 0.8
        return [makes.line(rng, "lin", axis)] if alone else [makes.lines_apart(rng, "off", axis, other)]
    return measurements(rng)


UNSURE = {"offset", "lost_counts", "channel", "form_bump", "warm_up", "screw_periodic", "position_map", "straightness",
          "angular", "reversal_spike"}


def know_well(rng, case, needs):
    """What the model holds, each some 3 % off; whether the effect that is needed is there."""
    menu = [name for r in case.records for name in r.menu if kind_of(name) not in UNSURE]
    rng.shuffle(menu)
    menu.sort(key=lambda name: not name.startswith(needs))
    if needs and not menu[0].startswith(needs):
        return False
    if needs == "thermal":
        menu = menu[:1]
    for name in menu[:int(rng.integers(2, 4))]:
        kinds = {kind_of(effect) for effect in case.known}
        if kind_of(name) == "rotation" and "squareness" in kinds:
            continue
        if kind_of(name) == "squareness" and kinds & {"rotation", "squareness"}:
            continue
        effect = draw(rng, name, case.records)
        effect = effect and sized(case, effect, rng.uniform(5, 25))
        if effect:
            case.known.append(effect)
            case.given.append(scaled(effect, 1 + np.clip(0.03 * rng.standard_normal(), -0.06, 0.06)))
    return any(effect["name"].startswith(needs) for effect in case.known)


def hold_out_of(rng, case, known, zeros):
    record = copy.deepcopy(case.records[0])
    record.name = "hold"
    other = copy.copy(case)
    other.records, other.known, other.zeros = [record], known, zeros
    measure(rng, other)
    return record


def case_mistakes(rng, seed):
    kind = list(MISTAKES)[seed % len(MISTAKES)]
    for _ in range(300):
        records = measured_wrong(rng, kind)
        record = records[0]
        if record.kind == "feed_sweep" and kind == "other_machine":
            continue
        case = begin(rng, records)
        case.walk = case.correlation = 0
        case.mistake = kind
        if kind == "dir_flip" and not record.both_ways:
            continue
        if not know_well(rng, case, MISTAKES[kind].needs):
            continue
        measure(rng, case)
        response = record.responses[0]
        if kind in NEED_SIZE and np.std(record.error[response]) / case.sigma["error"] < 4:
            continue
        if kind == "other_machine":
            signs = [1 if kind_of(effect) in NOT_NEGATIVE else rng.choice([-1, 1]) for effect in case.known]
            elsewhere = [scaled(effect, sign * rng.uniform(2, 4)) for effect, sign in zip(case.known, signs)]
            case.mistaken = [hold_out_of(rng, case, elsewhere, {})]
            case.holdouts = [hold_out_of(rng, case, case.known, case.zeros)]
            return case
        wrong = copy.deepcopy(record)
        if MISTAKES[kind].done(rng, case, wrong) is False:
            continue
        case.mistaken = [wrong]
        return case
    return None


CLASSES = {
    "one": case_one,
    "nothing": case_nothing,
    "two": case_two,
    "stranger": case_stranger,
    "many": case_many,
    "mistakes": case_mistakes,
}


def case_of(name, seed):
    """Each seed of each class is one case."""
    number = list(CLASSES).index(name) + 1
    return CLASSES[name](np.random.default_rng([number, seed, 77]), seed)
