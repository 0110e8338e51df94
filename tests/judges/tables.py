#!/usr/bin/env python3
"""Judges a compensation table by hand of another program: reads it as its controller does, applies it to the machine that
machine.toml describes, and compares what is left with what was said of it.

  tables.py FORMAT TABLE MACHINE.toml SAID.json --axis x [--at T1=25,...] [--reference MM]

FORMAT: linuxcnc0, linuxcnc1 (with ,inch for a machine in inches), ssfk, siemens. Exit 0: the table is what was said; 1: it is not,
and why. The laws of the effects are written here anew, from their table in the formats' description; so are the controllers' rules.
"""
import argparse
import json
import math
import re
import sys
import tomllib


def wrong(why):
    print("wrong:", why)
    sys.exit(1)


def knots(xs, ys, p):
    if p <= xs[0]:
        return ys[0]
    for (a, b), (u, v) in zip(zip(xs, xs[1:]), zip(ys, ys[1:])):
        if p <= b:
            return u + (v - u) * (p - a) / (b - a)
    return ys[-1]


def error_um(machine, axis, p, direction, degc):
    """Position reached minus commanded, um."""
    total = 0.0
    for e in machine.get("effect", []):
        kind, *axes = e["name"].split(".")
        if axes[0] != axis:
            continue
        if kind == "offset":
            total += e["um"]
        elif kind == "scale":
            total += e["ppm"] * p / 1000
        elif kind == "position_map":
            total += knots(e["knots_mm"], e["um"], p)
        elif kind == "screw_periodic":
            total += e["um"] * math.sin(2 * math.pi * p / e["period_mm"] + e.get("phase_rad", 0.0))
        elif kind == "reversal":
            total += e["um"] * direction / 2
        elif kind == "thermal_growth":
            d = degc.get(e["sensor"], 20.0) - e.get("reference_degC", 20.0)
            total += e["um_per_K"] * d + e.get("um_per_K2", 0.0) * d * d
        elif kind == "thermal_expansion":
            d = degc.get(e["sensor"], 20.0) - e.get("reference_degC", 20.0)
            total += e["ppm_per_K"] * d * p / 1000
        else:
            wrong(f"no law here for {e['name']}")
    return total


def linuxcnc(text, trims, unit_mm):
    """As usrmotLoadComp: it stops at the first line that is not three numbers. Motor command minus command, mm."""
    rows = []
    for n, line in enumerate(text.splitlines(), 1):
        words = line.split()
        try:
            nominal, forward, reverse = (float(w) for w in words)
        except ValueError:
            wrong(f"LinuxCNC stops at line {n}, {line!r}, and has {len(rows)} points")
        if len(line.encode()) + 1 >= 255:
            wrong(f"line {n} is longer than LinuxCNC reads")
        if rows and nominal <= rows[-1][0]:
            wrong(f"line {n}: {nominal} after {rows[-1][0]}")
        if trims:
            rows.append((nominal, forward, reverse))
        else:
            rows.append((nominal, nominal - forward, nominal - reverse))
    if not 2 <= len(rows) <= 256:
        wrong(f"{len(rows)} points")
    xs, up, down = ([r[k] * unit_mm for r in rows] for k in range(3))
    return xs, up, down


def ssfk(text):
    """A compensation value list; the value is subtracted from the command (value = reached minus setpoint)."""
    keys = {}
    for line in text.splitlines():
        key, value = line.split()
        if key in keys or not re.fullmatch(r"-?\d+", value):
            wrong(f"line {line!r}: a key once, a whole number")
        keys[key] = int(value)
    if keys.pop("kopf.achs_nr") < 1:
        wrong("no axis number")
    head = {k: keys.pop("kw.ssfk." + k) for k in ("interval", "kw_startpos", "kw_nr_max", "unit", "bilateral", "modulo")}
    n = head["kw_nr_max"]
    if (head["unit"], head["bilateral"], head["modulo"], head["interval"]) != (1, 1, 0, 0) or n > 1500:
        wrong(f"header {head}")
    columns = [[keys.pop(f"kw.ssfk.table[{i}].{k}") for i in range(n)] for k in ("setpoint", "pos", "neg")]
    if keys:
        wrong(f"left over: {list(keys)[:3]}")
    if head["kw_startpos"] != columns[0][0] or any(b <= a for a, b in zip(columns[0], columns[0][1:])):
        wrong("positions do not rise from kw_startpos")
    xs, up, down = ([v * 1e-4 for v in c] for c in columns)
    return xs, [-v for v in up], [-v for v in down]


def siemens(text, reference):
    """$AA_ENC_COMP: a positive value moves the axis in the negative direction."""
    lines = text.splitlines()
    if lines[:2] != ["%_N_AX_EEC_INI", "CHANDATA(1)"] or lines[-1] != "M17":
        wrong("frame of the file")
    values, head = [], {}
    for line in lines[2:-1]:
        point = re.fullmatch(r"\$AA_ENC_COMP\[([01]),(\d+),(\w+)\]=(-?\d+\.\d+)", line)
        other = re.fullmatch(r"\$AA_ENC_COMP_(STEP|MIN|MAX|IS_MODULO)\[([01]),(\w+)\]=(-?[\d.]+)", line)
        if point and int(point[2]) == len(values):
            values.append(float(point[4]))
        elif other:
            head[other[1]] = float(other[4])
        else:
            wrong(f"line {line!r}")
    n = (head["MAX"] - head["MIN"]) / head["STEP"]
    if head["IS_MODULO"] != 0 or abs(n + 1 - len(values)) > 1e-6:
        wrong(f"{len(values)} points for {head}")
    xs = [head["MIN"] + i * head["STEP"] for i in range(len(values))]
    if abs(knots(xs, values, reference)) > 1.5e-6:
        wrong(f"{knots(xs, values, reference)} at the reference point")
    return xs, [-v for v in values], [-v for v in values]


def main():
    parser = argparse.ArgumentParser()
    for name in ("format", "table", "machine", "said"):
        parser.add_argument(name)
    parser.add_argument("--axis", required=True)
    parser.add_argument("--at", default="")
    parser.add_argument("--reference", type=float, default=0.0)
    a = parser.parse_args()
    with open(a.machine, "rb") as f:
        machine = tomllib.load(f)
    with open(a.said) as f:
        said = json.load(f)
    with open(a.table, newline="") as f:
        text = f.read()
    degc = {n: float(v) for n, v in (w.split("=") for w in a.at.split(",") if w)}
    if a.format.startswith("linuxcnc"):
        kind, _, unit = a.format.partition(",")
        xs, up, down = linuxcnc(text, kind == "linuxcnc1", 25.4 if unit == "inch" else 1.0)
    elif a.format == "ssfk":
        xs, up, down = ssfk(text)
    else:
        xs, up, down = siemens(text, a.reference)
    if len(xs) != said["points"]:
        wrong(f"{len(xs)} points, said {said['points']}")
    low, high = said["from_mm"], said["to_mm"]
    largest, squares, n = {1: 0.0, -1: 0.0}, 0.0, 20011
    for i in range(n):
        p = low + (high - low) * i / (n - 1)
        for direction, trims in ((1, up), (-1, down)):
            motor = p + knots(xs, trims, p)
            if a.format == "siemens":
                # The value belongs to what the encoder reads: the place at which place and value make the command.
                for _ in range(3):
                    motor = p + knots(xs, trims, motor)
            left = 1000 * (motor - p) + error_um(machine, a.axis, motor, direction, degc) - said["constant_um"]
            largest[direction] = max(largest[direction], abs(left))
            squares += left * left
    rms = math.sqrt(squares / (2 * n))
    print(f"left: up {largest[1]:.3f}, down {largest[-1]:.3f}, RMS {rms:.3f} um; said {said['max_up_um']:.3f}, "
          f"{said['max_down_um']:.3f}, {said['rms_um']:.3f}")
    # A command of an error away from the place: the model's slope times the error, a few nanometres.
    for found, stated in ((largest[1], said["max_up_um"]), (largest[-1], said["max_down_um"]), (rms, said["rms_um"])):
        if abs(found - stated) > 0.02 + 0.03 * stated:
            wrong(f"{found:.3f} um left, said {stated:.3f}")


main()
