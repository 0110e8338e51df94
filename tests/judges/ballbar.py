#!/usr/bin/env python3
"""A ballbar run evaluated with numpy alone: deviations about the least-squares circle, and its causes.

    ballbar.py RUN.csv RADIUS_MM      (columns t in s, a in rad, e in µm; both ways round, x to y)

Prints one JSON document.
"""
import json
import sys

import numpy as np

data = np.genfromtxt(sys.argv[1], delimiter=",", names=True)
radius = float(sys.argv[2])
t, a, e = data["t"], np.unwrap(data["a"]), data["e"]

# Sense and speed by the slope of the angle; the rows around a turning point have neither.
step = np.diff(a) / np.diff(t)
rate = np.concatenate([step[:1], (step[1:] + step[:-1]) / 2, step[-1:]])
turn = np.sign(rate)
speed = np.median(np.abs(rate)) * radius
s, c = np.sin(a), np.cos(a)

# Per ppm, µrad, µm and ms.
columns = {
    "radius": np.ones_like(a),
    "cx": c,
    "cy": s,
    "scale_mismatch_ppm": radius / 1000 * (c * c - s * s) / 2,
    "squareness_urad": radius / 1000 * s * c,
    "reversal_x": -turn * np.sign(s) * c / 2,
    "reversal_y": turn * np.sign(c) * s / 2,
    "servo_mismatch_ms": -turn * speed * s * c,
}
found, *_ = np.linalg.lstsq(np.column_stack(list(columns.values())), e, rcond=None)
out = dict(zip(columns, found))

for name, sense in (("G_ccw", 1), ("G_cw", -1)):
    own = turn == sense
    circle = np.column_stack([np.ones(own.sum()), c[own], s[own]])
    fit, *_ = np.linalg.lstsq(circle, e[own], rcond=None)
    out[name] = np.ptp(e[own] - circle @ fit)
print(json.dumps(out))
