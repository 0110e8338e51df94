#!/usr/bin/env python3
"""Circles and lines through test arcs by scipy: values to hold our fits against.

scipy_fits.py write   makes arcs.csv (points) and arcs_scipy.csv (fits) beside this file
scipy_fits.py check   fits arcs.csv again and fails where the recorded values differ
Circles: scipy.optimize.least_squares on geometric distances. Lines: numpy's SVD of the centred points.
"""
import csv
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

HERE = Path(__file__).parent


def make_sets():
    rng = np.random.default_rng(4854)
    sets = []
    for n, radius, span, noise_um in [
        (20, 38.1, 90, 0.7), (20, 38.354, 90, 8.0), (7, 5.0, 30, 1.0), (50, 120.0, 20, 2.0), (12, 25.0, 360, 3.0),
    ]:
        centre = rng.uniform(-50, 150, 2)
        angle = np.radians(rng.uniform(-180, 180) + np.linspace(0, span, n, endpoint=span < 360))
        r = radius + rng.normal(0, noise_um * 1e-3, n)
        sets.append(("circle", np.c_[centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle)]))
    for n, deg, noise_um in [(10, 0.0, 1.0), (15, 90.0, 2.0), (30, 7.125, 5.0)]:
        s = np.linspace(0, 60, n)
        e = rng.normal(0, noise_um * 1e-3, n)
        d = np.radians(deg)
        sets.append(("line", np.c_[20 + s * np.cos(d) - e * np.sin(d), 30 + s * np.sin(d) + e * np.cos(d)]))
    return sets


def fit(kind, p):
    if kind == "circle":
        residual = lambda q: np.hypot(p[:, 0] - q[0], p[:, 1] - q[1]) - q[2]
        m = p.mean(0)
        a = np.c_[p - m, np.ones(len(p))]
        k = np.linalg.lstsq(a, ((p - m) ** 2).sum(1), rcond=None)[0]
        start = [k[0] / 2 + m[0], k[1] / 2 + m[1], np.sqrt(k[2] + (k[0] ** 2 + k[1] ** 2) / 4)]
        q = least_squares(residual, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        return [*q, np.std(residual(q), ddof=1) * 1e3]
    m = p.mean(0)
    normal = np.linalg.svd(p - m)[2][1]
    normal *= np.sign(normal[1] if abs(normal[1]) > 1e-9 else normal[0])
    return [*m, np.arctan2(normal[1], normal[0]), np.std((p - m) @ normal, ddof=1) * 1e3]


def main(mode):
    if mode == "write":
        with open(HERE / "arcs.csv", "w") as f:
            f.write("# made by scipy_fits.py\nset,kind,z_mm,x_mm\n")
            for i, (kind, p) in enumerate(make_sets()):
                f.writelines(f"{i},{kind},{z:.6f},{x:.6f}\n" for z, x in p)
    rows = [r for r in csv.reader(open(HERE / "arcs.csv")) if not r[0].startswith(("#", "set"))]
    fits = []
    for i in sorted({int(r[0]) for r in rows}):
        mine = [r for r in rows if int(r[0]) == i]
        fits.append((i, mine[0][1], fit(mine[0][1], np.array([[float(r[2]), float(r[3])] for r in mine]))))
    if mode == "write":
        with open(HERE / "arcs_scipy.csv", "w") as f:
            f.write("# made by scipy_fits.py: radius in mm of a circle, direction of the normal in rad of a line\n")
            f.write("set,kind,z_mm,x_mm,size,sd_um\n")
            f.writelines(f"{i},{k},{q[0]:.9f},{q[1]:.9f},{q[2]:.9f},{q[3]:.6f}\n" for i, k, q in fits)
        return
    recorded = [r for r in csv.reader(open(HERE / "arcs_scipy.csv")) if not r[0].startswith(("#", "set"))]
    assert len(recorded) == len(fits) > 0
    for (i, kind, q), row in zip(fits, recorded):
        assert np.allclose(q, [float(v) for v in row[2:]], rtol=0, atol=6e-7), (i, kind, q, row)
    print(f"{len(fits)} passed, 0 failed")


if __name__ == "__main__":
    main(sys.argv[1])
