"""A simulated shop: every machine's model, three months of records, and the planted causes."""

import numpy as np

import rtec

MONTHS = ("2026-05", "2026-06", "2026-07")
KNOWN = """name = "{name}"
[[effect]]
name = "reversal.x"
um = {um}
[[fit]]
response = "error.x"
date = "2026-01-10"
valid_until = "{until}"
rms_um = 0.3
half_width_um = 0.6
"""
TARGETS, CYCLES, NOISE_UM = 21, 3, 0.25


def numbered(n):
    return f"m{n:05}"


def planted(n, of):
    """The effects that machine n has beyond its model, by month, and what it shares with others."""
    about = {"hall": "south" if n % 10 < 3 else "north", "scales": "batch-7" if n % 17 == 4 else f"batch-{n % 3}"}
    each = {month: [] for month in MONTHS}
    note = {month: "" for month in MONTHS}
    if about["scales"] == "batch-7":
        for month in MONTHS:
            each[month].append(("offset_of_scale", 21.0))
    if about["hall"] == "south":
        each[MONTHS[2]].append(("heat", 24.0))
    if n % 19 == 6:
        note[MONTHS[1]] = "fixture=F3"
        each[MONTHS[1]].append(("fixture", 9.0))
    elif n % 3 == 0:
        note[MONTHS[1]] = f"fixture=F{n % 2 + 1}"
    single = None
    if n % 23 == 8:
        single = "screw_periodic.x"
        for month in MONTHS:
            each[month].append(("screw", 3.0))
    if n % 29 == 11:
        each[MONTHS[2]].append(("worn", 8.0))
    return about, each, note, single


def error_um(kind, size, p, up):
    match kind:
        case "offset_of_scale" | "heat":
            return size * p / 1000.0
        case "screw":
            return size * np.sin(2.0 * np.pi * p / 50.0)
        case "fixture":
            return np.full(p.size, size)
        case _:
            return size * up / 2.0


def run(n, month, seed=1):
    rng = np.random.default_rng([seed, n, MONTHS.index(month)])
    target = np.linspace(0.0, 500.0, TARGETS) + np.round(rng.uniform(-5, 5, TARGETS), 3)
    target.sort()
    p = np.concatenate([t for _ in range(CYCLES) for t in (target, target[::-1])])
    up = np.concatenate([s for _ in range(CYCLES) for s in (np.ones(TARGETS), -np.ones(TARGETS))])
    cycle = np.repeat(np.arange(1, CYCLES + 1), 2 * TARGETS).astype(float)
    e = model(n).predict(
        rtec.record("x.run.toml", "positioning", {"x": ("position.x", p), "d": ("direction.x", up), "e": ("error.x", 0 * p)})
    )["e"]
    _, each, note, _ = planted(n, None)
    for kind, size in each[month]:
        e = e + error_um(kind, size, p, up)
    e = e + rng.normal(0.0, NOISE_UM, p.size)
    columns = {"x": ("position.x", p), "d": ("direction.x", up), "n": ("cycle", cycle), "e": ("error.x", e)}
    return rtec.record(f"{numbered(n)}-{month}.run.toml", "positioning", columns, date=f"{month}-15", note=note[month] or None)


def model(n):
    rng = np.random.default_rng([7, n])
    until = "2026-08-20" if n % 41 == 5 else "2027-01-10"
    return rtec.Machine.parse(KNOWN.format(name=numbered(n), um=round(rng.normal(0, 3), 3), until=until))


def fill(shop, count):
    lines = []
    for n in range(count):
        about = planted(n, count)[0]
        lines.append(f'[{numbered(n)}]\nhall = "{about["hall"]}"\nscales = "{about["scales"]}"\n')
        shop.put_model(numbered(n), model(n))
        for month in MONTHS:
            shop.put(numbered(n), run(n, month))
    shop.write("machines.toml", "".join(lines).encode())
