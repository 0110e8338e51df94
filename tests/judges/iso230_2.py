#!/usr/bin/env python3
"""ISO 230-2 figures of a run and their uncertainties, computed with numpy alone.

    iso230_2.py RUN.csv POSITION DIRECTION ERROR [KEY=VALUE ...]

Prints one JSON document. KEY=VALUE are the contributors of the uncertainty, as the conditions file names them.
"""
import json
import sys

import numpy as np

path, position, direction, error = sys.argv[1:5]
stated = {k: float(v) for k, v in (word.split("=") for word in sys.argv[5:])}
data = np.genfromtxt(path, delimiter=",", names=True)
p, way, e = data[position], data[direction], data[error]

targets = np.unique(np.round(p, 3))
up = [e[(np.abs(p - t) < 0.01) & (way > 0)] for t in targets]
down = [e[(np.abs(p - t) < 0.01) & (way < 0)] for t in targets]
mu, md = (np.array([s.mean() for s in side]) for side in (up, down))
su, sd = (np.array([s.std(ddof=1) for s in side]) for side in (up, down))
b = mu - md
both = np.concatenate
found = {
    "A": np.ptp(both([mu + 2 * su, md + 2 * sd, mu - 2 * su, md - 2 * sd])),
    "A_up": (mu + 2 * su).max() - (mu - 2 * su).min(),
    "A_down": (md + 2 * sd).max() - (md - 2 * sd).min(),
    "E": np.ptp(both([mu, md])),
    "E_up": np.ptp(mu),
    "E_down": np.ptp(md),
    "M": np.ptp((mu + md) / 2),
    "R": np.max([2 * su + 2 * sd + np.abs(b), 4 * su, 4 * sd]),
    "R_up": 4 * su.max(),
    "R_down": 4 * sd.max(),
    "B": np.abs(b).max(),
    "B_mean": b.mean(),
}

if stated:
    get = lambda key: stated.get(key, 0.0)
    mm = targets[-1] - targets[0]
    n = min(len(s) for s in up + down)
    # A rectangular contributor of full width w: standard uncertainty w/(2·sqrt 3), expanded twice that.
    rectangular = lambda width: 2 * width / np.sqrt(12)
    along = [
        np.sqrt(get("device_um") ** 2 + (get("device_um_per_m") * mm / 1000) ** 2),
        rectangular(1000 * (np.sqrt(mm**2 + get("misalignment_mm") ** 2) - mm)),
        rectangular(2 * get("machine_temperature_K") * get("machine_ppm_per_K") * mm / 1000),
        rectangular(2 * get("machine_expansion_ppm_per_K") * get("machine_off_20_K") * mm / 1000),
        get("set_up_um"),
    ]
    eve = rectangular(get("drift_um"))
    u_r = 2 * eve
    u_b = eve * np.sqrt(2 / n)
    u_e = np.sqrt(np.sum(np.square(along)) + 2 * eve**2 / n)
    found["U"] = {
        "E": u_e,
        "B": u_b,
        "R_up": u_r,
        "R": np.hypot(u_r, u_b),
        "A": np.hypot(u_e, u_r),
        "M": np.sqrt(np.sum(np.square(along)) + eve**2 / n),
    }
print(json.dumps(found))
