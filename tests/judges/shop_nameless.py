"""Real life that no effect of the dictionary describes.

Each kind gives an extra error per run, the same machine on another day, and
the names that would truly describe a part of it.
"""
import numpy as np

import shop_records as rec
from shop_records import log_uniform, pick

# Sigma below which a shape without a name may pass as nothing: its many free
# forms cost more evidence than one amplitude.
SMALL_SHAPE = 15.0


def smooth_profile(rng, low, high, pieces):
    """A smooth random function of place: mean 0, size 1, `pieces` bends."""
    waves = [(rng.normal() / (1 + 0.3 * k), rng.uniform(0, 2 * np.pi), (k + rng.uniform(-0.3, 0.3)))
             for k in range(1, pieces + 1)]
    norm = np.sqrt(sum(a * a for a, _, _ in waves) / 2)
    return lambda p: sum(a * np.sin(2 * np.pi * f * (p - low) / (high - low) + b) for a, b, f in waves) / norm


def cached(function):
    """Remember a run's random error, because it is asked for more than once."""
    memory = {}

    def extra(run, response):
        key = (run.name, response)
        if key not in memory:
            memory[key] = function(run, response)
        return memory[key]
    return extra


def lines_plan(shop, count=1, long=False):
    axis = pick(shop.rng, shop.axes)
    return axis, [(rec.line, {"axis": axis, "long": long}) for _ in range(count)]


def wave_varies(shop, rng):
    axis, plan = lines_plan(shop, long=True)
    low, high = shop.travel[axis]
    form = smooth_profile(rng, low, high, 5)
    period, phase = pick(rng, [8.0, 10.0, 12.0, 16.0, 20.0]), rng.uniform(0, 6.3)
    mean = rng.uniform(0.0, 0.7)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        p = run.pos[axis]
        return (mean + form(p)) * np.sin(2 * np.pi * p / period + phase)
    return plan, extra, {f"screw_periodic.{axis}": {"period_mm": period}, f"screw_slope.{axis}": {"period_mm": period},
                         f"position_map.{axis}": {}}


def speed_resonance(shop, rng):
    plan = [(rec.drift, {}), (rec.drift, {})]
    axis = pick(rng, shop.axes)
    memory = {}

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        if "at" not in memory:                 # a speed that the spindle does run at
            speeds = np.unique(run.rpm[run.rpm > 0])
            memory["at"] = float(speeds[len(speeds) // 2]) * 1.01 if len(speeds) else 4000.0
            memory["width"] = rng.uniform(0.05, 0.12) * memory["at"]
        return np.where(run.rpm > 0, 1 / (1 + ((run.rpm - memory["at"]) / memory["width"]) ** 2), 0.0)
    return plan, extra, []


def creeping_stand(shop, rng):
    plan = [(rec.drift, {})] * int(rng.integers(1, 3))
    axis, tau = pick(rng, shop.axes), rng.uniform(20, 120)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        return np.log1p((run.t - run.t[0]) / tau) * (1 if run.name.endswith("1") else rng.uniform(0.4, 1.2))
    return plan, cached(extra), []


def stick_slip(shop, rng):
    axis, plan = lines_plan(shop, int(rng.integers(1, 3)), rng.random() < 0.6)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        p, way = run.pos[axis], run.dir[axis]
        pull, limit, out = 0.0, rng.uniform(0.5, 1.5), np.zeros(run.n)
        pitch = np.median(np.abs(np.diff(p)))
        for i in range(1, run.n):
            pull += 0.4 * abs(p[i] - p[i - 1]) / pitch * rng.uniform(0.5, 1.5)
            if pull > limit:
                pull, limit = rng.uniform(0, 0.3), rng.uniform(0.5, 2.0)
            out[i] = -way[i] * pull
        return out
    return plan, cached(extra), [f"reversal.{axis}"]


def thermal_bending(shop, rng):
    axis, plan = lines_plan(shop, 2)
    for _, arguments in plan:
        arguments["heat_share"] = 1.0
    low, high = shop.travel[axis]
    middle = low + (high - low) * rng.uniform(0.3, 0.7)
    near = [n for n, s in shop.sensors.items() if axis in s["gains"]]
    active = near[0] if near else list(shop.sensors)[-1]      # the sensor at the axis's own nut

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        return (run.temps[active] - 20.0) * ((run.pos[axis] - middle) / (high - low)) ** 2
    return plan, extra, [f"thermal_expansion.{axis}", f"thermal_growth.{axis}", f"position_map.{axis}"]


def clamping_jumps(shop, rng):
    axis, plan = lines_plan(shop, 2)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        levels = rng.normal(0, 1, int(run.cycle.max()) + 1)
        return levels[run.cycle]
    return plan, cached(extra), []


def air_conditioning(shop, rng):
    if rng.random() < 0.5:
        plan, axis = [(rec.drift, {})], pick(rng, shop.axes)
    else:
        axis, plan = lines_plan(shop, 1, True)
    period = rng.uniform(250, 900)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        turn = (run.t / period + rng.uniform()) % 1.0
        return np.where(turn < 0.3, turn / 0.3, (1 - turn) / 0.7) - 0.5
    return plan, cached(extra), []


def slow_wander(shop, rng):
    plan = [(rec.drift, {})] * int(rng.integers(1, 3))
    axis, memory = pick(rng, shop.axes), rng.uniform(300, 1500)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        out, state = np.zeros(run.n), 0.0
        for i in range(1, run.n):
            keep = np.exp(-(run.t[i] - run.t[i - 1]) / memory)
            state = keep * state + np.sqrt(1 - keep ** 2) * rng.normal()
            out[i] = state
        return out
    return plan, cached(extra), []


def ragged_backlash(shop, rng):
    axis, plan = lines_plan(shop, int(rng.integers(1, 3)))
    low, high = shop.travel[axis]
    form = smooth_profile(rng, low, high, 4)

    def extra(run, response):
        if response != f"error.{axis}":
            return np.zeros(run.n)
        return run.dir[axis] / 2 * form(run.pos[axis]) * 2
    return plan, extra, [f"reversal.{axis}", f"reversal_slope.{axis}"]


def bar_vibration(shop, rng):
    plane = (shop.axes[0], shop.axes[1])
    plan = [(rec.bar, {"plane": plane, "way": way}) for way in (1, -1)]
    rows_per_wave = rng.uniform(8, 40)

    def extra(run, response):
        gap = np.median(np.diff(run.t))
        frequency = rng.uniform(0.8, 1.25) / (rows_per_wave * gap)
        swell = 1 + 0.6 * np.sin(2 * np.pi * frequency * run.t / rng.uniform(7, 20))
        return np.sin(2 * np.pi * frequency * run.t + rng.uniform(0, 6.3)) * swell
    return plan, cached(extra), []


def stribeck(shop, rng):
    axis = pick(rng, shop.axes)
    knee = rng.uniform(5, 40)

    def extra(run, response):
        speed = run.vel[axis]
        return 20 * np.sign(speed) * np.exp(-np.abs(speed) / knee)
    return ([(rec.dynamics, {"axis": axis})] * int(rng.integers(1, 3)), extra,
            [f"friction_coulomb.{axis}", f"friction_viscous.{axis}"])


def cogging(shop, rng):
    axis = pick(rng, shop.axes)
    pitch, phase = rng.uniform(8, 40), rng.uniform(0, 6.3)

    def extra(run, response):
        return 10 * np.sin(2 * np.pi * run.pos[axis] / pitch + phase)
    return [(rec.dynamics, {"axis": axis})] * int(rng.integers(1, 3)), extra, []


def ragged_form(shop, rng):
    lobes = np.arange(4, 30)
    sizes = rng.normal(0, 1, len(lobes)) / np.sqrt(lobes)
    phases = rng.uniform(0, 6.3, len(lobes))

    def extra(run, response):
        waves = np.cos(np.outer(run.angle, lobes) + phases)
        return waves @ sizes / np.sqrt(np.sum(sizes ** 2) / 2)
    return [(rec.ring, {"part": True})] * int(rng.integers(1, 3)), extra, ["probe_lobing"]


def root_of_load(shop, rng):
    axis = pick(rng, shop.axes)

    def extra(run, response):
        return np.sqrt(run.load[axis] / 500.0) + 0.5 * (run.load[axis] > 50)
    return [(rec.feed_sweep, {"axis": axis})] * 2, extra, [f"stiffness.{axis}"]


def root_of_speed(shop, rng):
    axis = pick(rng, shop.axes)

    def extra(run, response):
        return np.sign(run.vel[axis]) * np.sqrt(np.abs(run.vel[axis]) / 200.0)
    return [(rec.feed_sweep, {"axis": axis})] * 2, extra, [f"following_error.{axis}", f"reversal.{axis}"]


def dent_in_table(shop, rng):
    first, second = "x", shop.axes[1]
    place = rng.uniform(0.25, 0.75, 2)

    def extra(run, response):
        if response != f"error.{first}":
            return np.zeros(run.n)
        away = [(run.pos[a] - run.pos[a].min()) / np.ptp(run.pos[a]) - c for a, c in zip((first, second), place)]
        return 3 * np.exp(-(away[0] ** 2 + away[1] ** 2) / 0.03)
    return ([(rec.plate, {})] * 2, extra,
            [f"position_map.{first}", f"straightness.{first}.{second}"])


KINDS = [wave_varies, speed_resonance, creeping_stand, stick_slip, thermal_bending, clamping_jumps, air_conditioning,
         slow_wander, ragged_backlash, bar_vibration, stribeck, cogging, ragged_form, root_of_load, root_of_speed,
         dent_in_table]


def build_nameless(case, shop):
    """A machine fully in the model, and one error that has no name."""
    import shop_cases
    from shop_stats import Visibility
    rng = shop.rng
    maker = KINDS[case.seed % len(KINDS)]
    plan, shape, parts = maker(shop, rng)
    if not shop_cases.build(case, shop, plan, int(rng.integers(0, 3)), 0):
        return False
    if maker is clamping_jumps and max(r.cycle.max() for r in case.train) < 3:
        return False
    case.scenario, case.extra_name = "nameless", maker.__name__
    case.parts = parts if isinstance(parts, dict) else {name: {} for name in parts}
    loud = np.sqrt(np.mean(np.concatenate([shape(r, x) for r in case.train for x in r.responses
                                           if np.any(shape(r, x))] or [np.zeros(1)]) ** 2))
    if not loud > 0:
        return False
    force = case.train[0].responses[0].startswith("force")
    size = (log_uniform(rng, 4, 25) if force else log_uniform(rng, 0.6, 6) * np.sqrt(shop.grade)) / loud
    case.extra = lambda run, response: size * shape(run, response)
    case.extra_snr = Visibility(case.train, case.known, []).extra_snr(case.extra)
    if case.extra_snr < SMALL_SHAPE and rng.random() < 0.8:
        return False
    shop_cases.finish(case)
    return True
