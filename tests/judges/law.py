#!/usr/bin/env python3
"""Judge of RTEC's control law: the recorded shift, computed again by another hand.

    python3 law.py FOLDER

FOLDER holds `machine.toml` (what the corrector knew) and `shift.csv` (one row per evaluation of the law: scale
positions in counts of 1 um, sensors, the operator's total on X, and the totals that were asked for). The engine of the
shift inserts at once. Prints how many totals agree, count for count; every disagreement with both totals and how near
the law was to another decision. Exit codes: 0 all agree, 1 a disagreement, 2 bad input.

Written from the guide's reference and the documentation of rtec-correct; the program was read where these leave a choice
open. Effects are the laws of tools/guide/reference/effects.md in closed form; the lag is the superposition of the answers to every kink of its input; the
travel of a spike is a path length. Standard library only, Python 3.11.
"""

import csv
import math
import sys
import tomllib
from pathlib import Path

# What the shift was recorded with.
COUNT_UM, INCREMENT, WINDOW, LIMIT = 1.0, 2, 50, 1000
RAMP_UM_S, LEAD_S = 5.0, 0.02
# What the law's documentation states.
HYSTERESIS = 0.02  # beyond half an increment, in increments
DEAD = 0.25  # half the dead band of what sensors ask for, in increments
LONGEST_S = 1.0  # the ramp goes no further at once
TURNED = 2  # counts beyond an increment
SETTLED, SPEED_OVER = 30, 3  # evaluations
STANDARD_DEGC = 20.0
COLD_K = 1.0
SLOW = {"thermal_expansion", "thermal_growth", "thermal_lag"}  # what sensors ask for


def nearest(value):
    """The nearest whole number, halves away from zero."""
    return int(math.copysign(math.floor(abs(value) + 0.5), value))


def clamp(value, low, high):
    return min(max(value, low), high)


# --- effects -----------------------------------------------------------------------------------------------------


class AxisNow:
    """One axis as an effect sees it."""

    def __init__(self, p_mm=0.0, v_mm_s=0.0, a_mm_s2=0.0, direction=0):
        self.p_mm, self.v_mm_s, self.a_mm_s2, self.direction = p_mm, v_mm_s, a_mm_s2, direction

    def ahead(self, lead_s, age_s=0.0):
        """As it will be: the speed is `age_s` old, and one that falls goes on falling, to rest and no further."""
        left = self.v_mm_s
        if self.v_mm_s > 0.0 > self.a_mm_s2:
            left = max(self.v_mm_s + self.a_mm_s2 * (lead_s + age_s), 0.0)
        elif self.v_mm_s < 0.0 < self.a_mm_s2:
            left = min(self.v_mm_s + self.a_mm_s2 * (lead_s + age_s), 0.0)
        return AxisNow(self.p_mm + self.v_mm_s * lead_s, left, self.a_mm_s2, self.direction)


class Spike:
    """Path travelled since the last row of the old direction; none before the first reversal."""

    def __init__(self):
        self.path_mm = 0.0
        self.last_mm = None
        self.direction = 0  # last that was not 0
        self.path_at_old = 0.0  # path at the last row of a direction
        self.start = None

    def travel(self, p_mm, direction):
        if self.last_mm is not None:
            self.path_mm += abs(p_mm - self.last_mm)
        self.last_mm = p_mm
        if direction == 0:
            return None
        if self.direction and direction != self.direction:
            self.start = self.path_at_old
        self.direction, self.path_at_old = direction, self.path_mm
        return None if self.start is None else self.path_mm - self.start


class Lag:
    """A first-order lag of an input that is linear between rows, in equilibrium at its first row.

    y = u0 + sum over kinks of (change of slope) * r(t - t_kink), r(t) = t - tau * (1 - exp(-t / tau)): no recursion,
    and so no rounding that adds up.
    """

    def __init__(self, tau_s):
        self.tau_s = tau_s
        self.first = None
        self.kinks = []  # (t, change of slope)
        self.slope = 0.0
        self.last = None

    def at(self, t, u):
        if self.last is None:
            self.first, self.last = u, (t, u)
            return u
        t0, u0 = self.last
        if t > t0:
            slope = (u - u0) / (t - t0)
            if slope != self.slope:
                self.kinks.append((t0, slope - self.slope))
            self.slope, self.last = slope, (t, u)
        tau = self.tau_s
        answers = (ds * ((t - tk) + tau * math.expm1(-(t - tk) / tau)) for tk, ds in self.kinks)
        return self.first + math.fsum(answers)


def broken_line(knots, heights, p):
    """Linear between knots, constant beyond the end ones."""
    if p <= knots[0]:
        return heights[0]
    for k0, k1, e0, e1 in zip(knots, knots[1:], heights, heights[1:]):
        if p <= k1:
            return e0 + (e1 - e0) * (p - k0) / (k1 - k0)
    return heights[-1]


def sine(p_mm, period_mm, e):
    return e["um"] * math.sin(2.0 * math.pi * p_mm / period_mm + e["phase_rad"])


def growth(e, delta_k):
    return e["um_per_K"] * delta_k + e.get("um_per_K2", 0.0) * delta_k * delta_k


class Model:
    """The effects of a machine file."""

    # What every effect here may say of itself; anything else is an error, never left out.
    KEYS = {
        "offset": {"um"},
        "scale": {"ppm"},
        "position_map": {"knots_mm", "um"},
        "screw_periodic": {"period_mm", "um", "phase_rad"},
        "reversal": {"um"},
        "reversal_spike": {"um", "length_mm"},
        "subdivision": {"period_um", "um", "phase_rad"},
        "squareness": {"urad"},
        "straightness": {"knots_mm", "um"},
        "following_error": {"ms"},
        "acceleration_error": {"um_per_m_s2"},
        "thermal_expansion": {"sensor", "minus", "reference_degC", "ppm_per_K"},
        "thermal_growth": {"sensor", "minus", "reference_degC", "um_per_K", "um_per_K2"},
        "thermal_lag": {"sensor", "minus", "reference_degC", "um_per_K", "um_per_K2", "tau_s"},
    }

    def __init__(self, effects):
        self.effects = []
        for e in effects:
            kind, *axes = e["name"].split(".")
            unknown = set(e) - {"name"} - self.KEYS.get(kind, set())
            if kind not in self.KEYS or unknown or {"minus", "reference_degC"} <= set(e):
                raise ValueError(f"effect {e['name']}: {unknown or 'no law here'}")
            state = {"reversal_spike": Spike, "thermal_lag": lambda e=e: Lag(e["tau_s"])}.get(kind)
            self.effects.append((kind, axes, e, state and state()))

    def errors_um(self, t_s, now, degc):
        """Errors of every axis, um, what moves with the axes and what sensors ask for: `now` by axis, `degc` by sensor."""
        out, slow = {axis: 0.0 for axis in now}, {axis: 0.0 for axis in now}
        for kind, axes, e, state in self.effects:
            at = [now.get(axis, AxisNow()) for axis in axes]
            delta_k = 0.0
            if "sensor" in e:
                minus = degc[e["minus"]] if "minus" in e else e.get("reference_degC", STANDARD_DEGC)
                delta_k = degc[e["sensor"]] - minus
            first = at[0]
            if kind == "offset":
                um = e["um"]
            elif kind == "scale":
                um = e["ppm"] * first.p_mm / 1000.0
            elif kind == "position_map":
                um = broken_line(e["knots_mm"], e["um"], first.p_mm)
            elif kind == "straightness":
                um = broken_line(e["knots_mm"], e["um"], at[1].p_mm)
            elif kind == "screw_periodic":
                um = sine(first.p_mm, e["period_mm"], e)
            elif kind == "subdivision":
                um = sine(first.p_mm, e["period_um"] / 1000.0, e)
            elif kind == "reversal":
                um = e["um"] * first.direction / 2.0
            elif kind == "reversal_spike":
                d_mm = state.travel(first.p_mm, first.direction)
                um = 0.0 if d_mm is None else e["um"] * first.direction * math.exp(-d_mm / e["length_mm"])
            elif kind == "squareness":
                um = e["urad"] * at[1].p_mm / 1000.0
            elif kind == "following_error":
                um = e["ms"] * first.v_mm_s
            elif kind == "acceleration_error":
                um = e["um_per_m_s2"] * first.a_mm_s2 / 1000.0
            elif kind == "thermal_expansion":
                um = e["ppm_per_K"] * delta_k * first.p_mm / 1000.0
            elif kind == "thermal_growth":
                um = growth(e, delta_k)
            else:
                um = growth(e, state.at(t_s, delta_k))
            if axes[0] in out:
                (slow if kind in SLOW else out)[axes[0]] += um
        return out, slow


# --- motion ------------------------------------------------------------------------------------------------------


class Turning:
    """Direction of the last motion: turned when scale and MTC's count both have come far enough."""

    def __init__(self):
        self.direction = 0
        self.furthest = None

    def follow(self, places, enough, own):
        if self.furthest is None:
            self.furthest = list(places)
            return
        away = [p - f for p, f in zip(places, self.furthest)]
        for d in (1, -1):
            if d != self.direction and min(a * d for a in away) > enough:
                self.direction, self.furthest = d, list(places)
                return
        if self.direction:
            # No further than insertions alone cannot have pretended.
            surely = [p - self.direction * own for p in places]
            beyond = max if self.direction > 0 else min
            self.furthest = [beyond(p, f) for p, f in zip(surely, self.furthest)]


class Motion:
    """Velocity over three evaluations, direction by scale and MTC."""

    def __init__(self, axes, count_um=COUNT_UM, increment=INCREMENT):
        self.axes, self.count_um, self.increment = axes, count_um, increment
        self.rows = []  # (t_s, positions, inserted)
        self.turning = {a: Turning() for a in axes}

    def follow(self, t_s, positions, inserted):
        if not self.rows or t_s > self.rows[-1][0]:
            self.rows.append((t_s, dict(positions), dict(inserted)))
            del self.rows[:-64]
        now = {}
        for a in self.axes:
            settled = self.rows[max(len(self.rows) - 1 - SETTLED, 0)]
            own = abs(inserted[a] - settled[2][a])
            self.turning[a].follow(
                (positions[a], positions[a] + inserted[a]), self.increment + TURNED + own, own
            )
            v = self.velocity(a, 0)
            before = self.velocity(a, SPEED_OVER)
            acceleration = 0.0
            if len(self.rows) > 2 * SPEED_OVER:
                span_s = self.rows[-1][0] - self.rows[-1 - 2 * SPEED_OVER][0]
                acceleration = (v - before) / (span_s / 2.0)
            now[a] = AxisNow(positions[a] * self.count_um / 1000.0, v, acceleration, self.turning[a].direction)
        return now

    def age_s(self):
        """A mean speed is that of the middle of its time."""
        if len(self.rows) <= SPEED_OVER:
            return 0.0
        return (self.rows[-1][0] - self.rows[-1 - SPEED_OVER][0]) / 2.0

    def velocity(self, axis, back):
        """mm/s over the SPEED_OVER evaluations that end `back` evaluations ago; 0 where they are not known."""
        if len(self.rows) <= back + SPEED_OVER:
            return 0.0
        (t0, p0, _), (t1, p1, _) = self.rows[-1 - back - SPEED_OVER], self.rows[-1 - back]
        return (p1[axis] - p0[axis]) * self.count_um / 1000.0 / (t1 - t0)


# --- totals ------------------------------------------------------------------------------------------------------


class Total:
    """Dead band, ramp, hysteresis, limit, window of one axis."""

    def __init__(self, count_um=COUNT_UM, increment=INCREMENT, window=WINDOW, limit=LIMIT):
        self.count_um, self.increment, self.window = count_um, increment, window
        self.limit = limit // increment * increment
        self.counts = 0  # without the operator
        self.operator = 0
        self.out_um = 0.0
        self.slow_um = 0.0  # what sensors ask for, past the dead band
        self.ramp_left_um = 0.0
        self.following = False
        self.margin = math.inf  # counts to the nearest other decision

    def next(self, um, slow_um, requested, ramp_um, changed):
        if not self.following:
            self.following = True
            self.counts = requested - self.operator
            self.out_um = self.counts * self.count_um
            changed = True
        if changed:
            self.slow_um = slow_um
            self.ramp_left_um = self.out_um - um - slow_um
        else:
            dead_um = DEAD * self.increment * self.count_um
            off_um = slow_um - self.slow_um
            due_um = math.copysign(max(abs(off_um) - dead_um, 0.0), off_um)
            self.slow_um += clamp(due_um, -ramp_um, ramp_um)
        self.ramp_left_um -= clamp(self.ramp_left_um, -ramp_um, ramp_um)
        self.out_um = um + self.slow_um + self.ramp_left_um
        wanted = self.out_um / self.count_um
        threshold = (0.5 + HYSTERESIS) * self.increment
        off = abs(wanted - self.counts)
        self.margin = abs(off - threshold)
        if off > threshold:
            steps = wanted / self.increment
            self.margin = min(self.margin, abs(steps - math.floor(steps) - 0.5) * self.increment)
            self.counts = clamp(nearest(steps) * self.increment, -self.limit, self.limit)
        bounded = clamp(self.counts + self.operator, -self.limit, self.limit)
        return clamp(bounded, requested - self.window, requested + self.window)


class Law:
    """The whole law. Its engine has inserted what it was asked for, or `inserted` says what has been."""

    def __init__(self, effects, axes, lead_s=LEAD_S, ramp_um_s=RAMP_UM_S, start_s=0.0):
        self.model, self.axes = Model(effects), axes
        self.lead_s, self.ramp_um_s, self.last_s = lead_s, ramp_um_s, start_s
        self.motion = Motion(axes)
        self.totals = {a: Total() for a in axes}
        self.requested = {a: 0 for a in axes}
        self.changed = True  # a model has been loaded

    def tick(self, t_s, positions, degc, inserted=None):
        dt_s, self.last_s = clamp(t_s - self.last_s, 0.0, LONGEST_S), t_s
        now = self.motion.follow(t_s, positions, self.requested if inserted is None else inserted)
        ahead = {a: n.ahead(self.lead_s, self.motion.age_s()) for a, n in now.items()}
        um, slow_um = self.model.errors_um(t_s, ahead, degc)
        for a in self.axes:
            ramp_um = self.ramp_um_s * dt_s
            self.requested[a] = self.totals[a].next(um[a], slow_um[a], self.requested[a], ramp_um, self.changed)
        self.changed = False
        return dict(self.requested)


# --- the recorded shift --------------------------------------------------------------------------------------------

AXES = ("x", "y", "z")
MOST_SHOWN = 40  # disagreements


def judge(folder):
    with open(folder / "machine.toml", "rb") as file:
        effects = tomllib.load(file).get("effect", [])
    with open(folder / "shift.csv", encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    if not rows:
        raise ValueError("shift.csv has no rows")
    law = Law(effects, AXES)
    agreed, nearest_counts, wrong = 0, math.inf, []
    changes = {a: 0 for a in AXES}
    before = {a: 0 for a in AXES}
    for number, row in enumerate(rows):
        t_s = float(row["t_s"])
        degc = {name: float(row[name]) for name in ("T8", "T18")}
        if number == 0 and max(degc.values()) - min(degc.values()) > COLD_K:
            raise ValueError("the shift begins warm: the law would hold until its lags are known")
        law.totals["x"].operator = int(float(row["operator_x"]))
        mine = law.tick(t_s, {a: int(float(row[f"{a}_counts"])) for a in AXES}, degc)
        for a in AXES:
            told = int(float(row[f"total_{a}"]))
            margin = law.totals[a].margin
            nearest_counts = min(nearest_counts, margin)
            changes[a] += told != before[a]
            before[a] = told
            if mine[a] == told:
                agreed += 1
            else:
                here = f"file {told}, here {mine[a]}, {margin:.1e} counts from another decision"
                wrong.append(f"{t_s:.2f} s, {a}: {here}")
                # One disagreement is one: what follows is judged from the file's total.
                law.requested[a] = told
                law.totals[a].counts = told - law.totals[a].operator
    print(f"{agreed} of {3 * len(rows)} totals agree; changes of a total: {changes}; ", end="")
    print(f"nearest any of them came to another decision: {nearest_counts:.1e} counts")
    for line in wrong[:MOST_SHOWN]:
        print(line)
    if len(wrong) > MOST_SHOWN:
        print(f"... and {len(wrong) - MOST_SHOWN} more")
    return 1 if wrong else 0


def main():
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        return judge(Path(sys.argv[1]))
    except (OSError, KeyError, ValueError) as error:
        print(f"law.py: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
