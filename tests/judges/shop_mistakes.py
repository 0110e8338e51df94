"""Mistakes that people make with records, beside good records and a true model.

A mistake that only shows by contradicting the other records is used where the
contradiction is plain: the fit with the model's amplitudes held at 10 % grows
by at least `CONTRADICTION` squared sigma.
"""
import copy

import numpy as np

import shop_records as rec
from shop_laws import LINEAR, signal, split_name, total
from shop_records import pick
from shop_stats import Stack

CONTRADICTION = 80.0


# Where a mistake can happen at all; the others fit any plan.
SUITS = {"swapped_responses": ["drift", "plate"], "swapped_positions": ["plate"], "mirrored_angle": ["lines_bars"],
         "wrong_bar": ["lines_bars"], "other_axis": ["lines", "lines_bars"], "swapped_sensors": ["drift", "lines"],
         "flipped_direction": ["lines", "lines_bars", "plate", "probing"], "sensor_stuck": ["drift", "lines"],
         "flipped_speed": ["dynamics", "feed_sweep", "probing"], "sensor_unplugged": ["drift", "lines", "lines_bars", "feed_sweep"],
         "degrees_fahrenheit": ["drift", "lines", "lines_bars", "feed_sweep"]}


def mistake_plan(shop, mistake):
    """Plans where each kind of record stands at least twice."""
    rng = shop.rng
    axes = shop.axes
    kind = pick(rng, SUITS.get(mistake.__name__, ["lines", "lines", "lines_bars", "lines_bars", "drift", "plate", "dynamics",
                                                  "feed_sweep", "probing"]))
    a, b = axes[0], axes[1]
    if kind == "lines":
        plan = [(rec.line, {"axis": a}), (rec.line, {"axis": a}), (rec.line, {"axis": b}), (rec.line, {"axis": b})]
    elif kind == "lines_bars":
        radius, tell = float(pick(rng, [50, 100, 150])), pick(rng, ["centre", "positions", "nothing"])
        feed = pick(rng, [500.0, 1000.0, 2000.0])
        plan = [(rec.line, {"axis": a}), (rec.line, {"axis": b})]
        plan += [(rec.bar, {"plane": (a, b), "way": w, "radius": radius, "tell": tell, "feed": feed}) for w in (1, -1, 1)]
    elif kind == "drift":
        plan = [(rec.drift, {})] * 2
    elif kind == "plate":
        plan = [(rec.plate, {})] * 2
    else:
        axis = pick(rng, axes)
        maker = {"dynamics": rec.dynamics, "feed_sweep": rec.feed_sweep, "probing": rec.probing}[kind]
        plan = [(maker, {"axis": axis})] * 2
    return kind, plan


def circle_again(run):
    """Positions and directions as a reader finds them from angle and radius."""
    ways = np.sign(np.gradient(run.angle))
    rate = np.abs(np.gradient(run.angle, run.t, edge_order=1)) if run.n > 2 else np.ones(run.n)
    rate = np.where(np.isfinite(rate), rate, np.nanmedian(rate))
    for i, axis in enumerate(run.plane):
        turn = np.cos(run.angle) if i == 0 else np.sin(run.angle)
        along = -np.sin(run.angle) if i == 0 else np.cos(run.angle)
        run.pos[axis] = run.centre[i] + run.radius * turn
        run.dir[axis] = np.sign(along * ways)
        run.vel[axis] = along * ways * rate * run.radius


def scale_errors(run, factor):
    for response in run.responses:
        run.measured[response] = run.measured[response] * factor


def error_unit(run, rng, shop):
    scale_errors(run, pick(rng, [1000.0, 0.001, 25.4, 1 / 25.4, 10.0]))
    return "unit"


def error_sign(run, rng, shop):
    scale_errors(run, -1.0)
    return "sign"


def swapped_responses(run, rng, shop):
    if len(run.responses) < 2:
        return None
    a, b = run.responses[:2]
    run.measured[a], run.measured[b] = run.measured[b], run.measured[a]
    return "swapped"


def swapped_positions(run, rng, shop):
    if run.kind != "plate":
        return None
    a, b = sorted(run.pos)
    run.pos[a], run.pos[b] = run.pos[b], run.pos[a]
    return "swapped"


def mirrored_angle(run, rng, shop):
    if run.kind != "ballbar" or "position" in run.logged:
        return None
    run.angle = -run.angle
    circle_again(run)
    return "mirrored angle"


def wrong_bar(run, rng, shop):
    if run.kind != "ballbar" or "position" in run.logged:
        return None
    run.radius = pick(rng, [r for r in (50.0, 100.0, 150.0, 200.0, 300.0) if r != run.radius])
    circle_again(run)
    return "bar length"


def other_axis(run, rng, shop):
    if run.kind != "positioning":
        return None
    old = run.responses[0].split(".")[1]
    new = pick(rng, [a for a in shop.axes if a != old])
    for table in (run.pos, run.dir):
        table.pop(new, None)
        table[new] = table.pop(old)
    for table in (run.measured, run.noise):
        table[f"error.{new}"] = table.pop(f"error.{old}")
    run.responses = [f"error.{new}" if r == f"error.{old}" else r for r in run.responses]
    return "other axis"


def flipped_direction(run, rng, shop):
    if "direction" not in run.logged or not run.dir:
        return None
    for axis in run.dir:
        run.dir[axis] = -run.dir[axis]
    return "direction"


def flipped_speed(run, rng, shop):
    if "velocity" not in run.logged:
        return None
    for axis in run.vel:
        run.vel[axis] = -run.vel[axis]
        run.dir[axis] = -run.dir[axis]
    return "sign"


def mirrored_position(run, rng, shop):
    if "position" not in run.logged or run.kind == "ballbar":
        return None
    for axis in run.pos:
        run.pos[axis] = -run.pos[axis]
    return "sign"


def position_unit(run, rng, shop):
    if "position" not in run.logged or run.kind == "ballbar":
        return None
    factor = pick(rng, [1 / 25.4, 0.1, 0.001, 25.4])
    for axis in run.pos:
        run.pos[axis] = run.pos[axis] * factor
    return "unit"


def swapped_sensors(run, rng, shop):
    names = list(run.temps)
    if len(names) < 2:
        return None
    a, b = [names[i] for i in rng.choice(len(names), 2, replace=False)]
    run.temps[a], run.temps[b] = run.temps[b], run.temps[a]
    return "swapped"


# The next kinds show in the record itself; they change the written table.

def edit_column(run, name, values):
    run.logged_table = [(n, r, u, values if n == name else v, d) for n, r, u, v, d in run.logged_table]


def sensor_stuck(run, rng, shop):
    lively = [n for n, v in run.temps.items() if np.ptp(v[run.n // 3:]) > 1.5]
    if not lively or run.n < 40:
        return None
    name = pick(rng, lively)
    values = next(v for n, _, _, v, _ in run.logged_table if n == name).copy()
    row = int(rng.integers(run.n // 5, run.n // 3 + 1))
    if len(np.unique(values[:row])) < 4:                  # it hardly moved before: nobody could see it
        return None
    values[row:] = values[row]
    edit_column(run, name, values)
    return "stuck"


def sensor_unplugged(run, rng, shop):
    if not run.temps:
        return None
    name = pick(rng, list(run.temps))
    values = next(v for n, _, _, v, _ in run.logged_table if n == name).copy()
    row = int(rng.integers(run.n // 4, 3 * run.n // 4))
    end = run.n if rng.random() < 0.6 else min(run.n, row + max(5, run.n // 6))
    values[row:end] = pick(rng, [85.0, -127.0, -200.0, 327.6, 850.0])
    edit_column(run, name, values)
    return "unplugged"


def degrees_fahrenheit(run, rng, shop):
    if not run.temps:
        return None
    names = set(run.temps) if rng.random() < 0.7 else {pick(rng, list(run.temps))}
    change = (lambda v: v * 1.8 + 32) if rng.random() < 0.6 else (lambda v: v + 273.15)
    run.logged_table = [(n, r, u, change(v) if n in names else v, d) for n, r, u, v, d in run.logged_table]
    return "unit"


def doubled_rows(run, rng, shop):
    if run.n < 30:
        return None
    start = int(rng.integers(3, run.n // 2))
    length = int(rng.integers(max(10, run.n // 8), run.n // 3 + 1))
    rows = np.concatenate([np.arange(start), np.repeat(np.arange(start, start + length), 2), np.arange(start + length, run.n)])
    run.logged_table = [(n, r, u, np.asarray(v)[rows], d) for n, r, u, v, d in run.logged_table]
    return "doubled"


def decimal_shift(run, rng, shop):
    response = pick(rng, run.responses)
    column = next(n for n, r, _, _, _ in run.logged_table if r == response)
    values = run.measured[response].copy()
    noise = np.hypot(run.noise[response]["sigma"], run.noise[response]["step"])
    spread = np.std(values) + noise
    large = np.flatnonzero(np.abs(values) * 9 > 8 * spread)
    if len(large) < 8:
        return None
    rows = rng.choice(large, int(rng.integers(1, 5)), replace=False)
    values[rows] = values[rows] * pick(rng, [10.0, 100.0])
    edit_column(run, column, values)
    return "outliers"


def other_machine(run, rng, shop):
    """The record is another machine's: all its amplitudes are others."""
    for effect in shop.known:
        factor = rng.uniform(-2, 3)
        for response, values in signal(effect, run).items():
            run.measured[response] = run.measured[response] + (factor - 1) * values
    return "other machine"


BY_CONTRADICTION = [error_unit, error_sign, other_machine, swapped_responses, swapped_positions, mirrored_angle, wrong_bar, other_axis,
                    flipped_direction, flipped_speed, mirrored_position, position_unit, swapped_sensors]
BY_ITSELF = [sensor_stuck, sensor_unplugged, degrees_fahrenheit, doubled_rows, decimal_shift]


def misfit(case, runs):
    """Squared sigma left with the model's amplitudes held at 10 % and set-up free."""
    stack = Stack(runs)
    target = stack.vector(lambda run: {r: run.measured[r] - total(case.model, run)[r] for r in run.responses})
    free = stack.setup(case.known)
    held = []
    for effect in case.model:
        for key in LINEAR[split_name(effect["name"])[0]]:
            size = 1.0 if isinstance(effect.get(key), list) else effect.get(key)
            if size:
                held += [0.1 * size * c for c in stack.linear(effect, [key])]
    matrix = np.array(free + held).T
    lower = np.hstack([np.zeros((len(held), len(free))), np.eye(len(held))])
    a = np.vstack([matrix, lower])
    y = np.concatenate([target, np.zeros(len(held))])
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-12)
    x = np.linalg.lstsq(a / scale, y, rcond=1e-10)[0]
    return float(np.sum((y - a / scale @ x) ** 2))


def build_mistake(case, shop):
    """A clean case, and the same with one person's mistake in one record."""
    import shop_cases
    rng = shop.rng
    kinds = BY_CONTRADICTION + BY_ITSELF
    first = kinds[case.seed % len(kinds)]                 # every kind gets its turn
    case.scenario, plan = mistake_plan(shop, first)
    if not shop_cases.build(case, shop, plan, int(rng.integers(1, 4)), 0):
        return False
    shop_cases.finish(case)
    for run in case.train + case.holdout:
        run.logged_table = rec.logged_columns(run, rng)
    clean = case.train
    before = misfit(case, clean)
    shop.known = case.known
    others = [kinds[i] for i in rng.permutation(len(kinds))[:3]] if case.attempt > 40 else []
    for mistake in [first] * 4 + others:
        at = int(rng.integers(len(clean)))
        run = copy.deepcopy(clean[at])
        what = mistake(run, rng, shop)
        if what is None:
            continue
        wrong = clean[:at] + [run] + clean[at + 1:]
        if mistake in BY_CONTRADICTION:
            grown = misfit(case, wrong) - before
            if not grown > CONTRADICTION:
                continue
            # Temperatures keep their noise: exchange the written columns too.
            state = np.random.default_rng([case.seed, at])
            run.logged_table = rec.logged_columns(run, state)
        case.clean_train, case.train = clean, wrong
        case.mistake = {"record": run.name, "what": what, "kind": mistake.__name__}
        return True
    return False
