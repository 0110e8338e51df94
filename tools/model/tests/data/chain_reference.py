"""Exact rational reference of the chain model, by SymPy: reads the chains beside it, prints chain_reference.csv.

    python3 chain_reference.py > chain_reference.csv

Columns: chain, x, y, z (mm), T1 T2 T3 T6 T8 T18 (degC), error x, y, z (um).
"""

import pathlib
import tomllib
from decimal import Decimal

from sympy import Matrix, Rational, eye

HERE = pathlib.Path(__file__).parent
NAMES = ["T1", "T2", "T3", "T6", "T8", "T18"]
CASES = [
    ("turning_centre.toml", ["0", "0", "0"], ["20", "20", "20", "20", "20", "20"]),
    ("turning_centre.toml", ["85.5", "0", "-240.25"], ["21.5", "22.25", "23", "31.5", "36.75", "20.5"]),
    ("turning_centre.toml", ["-40", "0", "310"], ["20", "19.5", "20.75", "24", "27.5", "21"]),
    ("three_axis.toml", ["250", "-120.5", "-300"], ["23.5", "20", "20", "26", "33.25", "21"]),
    ("three_axis.toml", ["-310", "205", "-12.5"], ["20", "20", "20", "20", "20", "20"]),
    ("three_axis.toml", ["0", "0", "0"], ["20", "20", "20", "29", "35", "20"]),
]


def rational(value):
    return Rational(str(value))


def transform(d, r):
    return Matrix([[1, -r[2], r[1], d[0]], [r[2], 1, -r[0], d[1]], [-r[1], r[0], 1, d[2]], [0, 0, 0, 1]])


def end(chain, branch, p, t, errors):
    m = eye(4)
    for joint in chain["joint"]:
        if joint["branch"] != branch:
            continue
        at = [rational(v) for v in joint.get("offset_mm", [0, 0, 0])]
        moved = Rational(0)
        if "axis" in joint:
            moved = p[joint["axis"]]
            own = [int(joint["axis"] == a) for a in "xyz"]
            at = [a + rational(d) * moved for a, d in zip(at, joint.get("direction", own))]
        m = m * transform(at, [0, 0, 0])
        six = dict.fromkeys(["dx", "dy", "dz", "ex", "ey", "ez"], Rational(0))
        for c in joint.get("component", []):
            delta = Rational(0)
            if "sensor" in c:
                zero = t[c["minus"]] if "minus" in c else rational(c.get("reference_degC", 20))
                delta = t[c["sensor"]] - zero
            for term in c["terms"]:
                six[c["of"]] += (
                    rational(term["value"]) * (moved / 100) ** term.get("p", 0) * delta ** term.get("dT", 0)
                )
        if errors:
            m = m * transform(
                [six[k] / 1000 for k in ("dx", "dy", "dz")], [six[k] / 1000000 for k in ("ex", "ey", "ez")]
            )
    return m


for name, position, temperature in CASES:
    chain = tomllib.loads((HERE / name).read_text(), parse_float=Decimal)
    p = dict(zip("xyz", map(Rational, position)))
    t = dict(zip(NAMES, map(Rational, temperature)))
    tip = Matrix([*[rational(v) for v in chain["tool_mm"]], 1])
    seen = [end(chain, "work", p, t, e).inv() * end(chain, "tool", p, t, e) * tip for e in (True, False)]
    error = [1000 * (a - b) for a, b in zip(seen[0], seen[1])][:3]
    print(",".join([name, *position, *temperature, *[str(e.evalf(20)) for e in error]]))
