"""How well a case's records can show an effect: signal to noise and rivals.

All vectors are stacked over the training records and divided by the noise,
quantisation included.  A row of a coarse gauge that noise does not dither
shares its rounding error with its repeats.
"""
import numpy as np

from shop_laws import (LINEAR, MAP_LAWS, SENSOR_LAWS, WAVE_LAWS, amplitudes, columns, setup_columns,
                       signal, split_name)

RIVAL_LIMIT = 9.0      # squared sigma left over below which the data cannot tell two names
# A rival that needs more than this is no rival: no machine has such an amplitude.
PLAUSIBLE = {"thermal_expansion": 30.0, "thermal_growth": 30.0, "thermal_lag": 30.0, "following_error": 10.0,
             "warm_up": 100.0, "scale": 300.0, "squareness": 500.0, "spindle_speed": 10.0, "coolant": 50.0,
             "reversal": 100.0, "reversal_spike": 50.0, "acceleration_error": 100.0, "stiffness": 1.0,
             "angular": 2000.0, "probe_latency": 10000.0, "lost_counts": 100.0}
SHAPE_STEPS = {"phase_rad": 1e-3, "period_mm": 1e-5, "period_um": 1e-5, "tau_s": 1e-2,
               "length_mm": 1e-2, "centre_rad": 1e-3, "width_rad": 1e-3}


def noise_sd(run, response):
    """Standard deviation per row, with autocorrelation, rounding and air wander."""
    noise = run.noise[response]
    sigma, step, phi = noise["sigma"], noise["step"], noise["phi"]
    rounding = step ** 2 / 12 * (run.place_repeats if sigma < step / 2 else 1)
    variance = sigma ** 2 * (1 + phi) / (1 - phi) + rounding
    air = run.setup.get("air_um", 0.0)
    if air and run.n > 1:
        decay = np.exp(-np.median(np.diff(run.t)) / 20.0)
        variance += air ** 2 * (1 + decay) / (1 - decay)
    return np.sqrt(variance)


class Stack:
    """Stacks per-response columns of several runs into whitened vectors."""

    def __init__(self, runs):
        self.runs, self.parts, start = runs, [], 0
        for run in runs:
            for response in run.responses:
                self.parts.append((run, response, start, noise_sd(run, response)))
                start += run.n
        self.n = start

    def vector(self, of_run):
        """Whitened vector of {response: column} given by `of_run(run)`."""
        out, cache = np.zeros(self.n), {}
        for run, response, start, sd in self.parts:
            if id(run) not in cache:
                cache[id(run)] = of_run(run)
            values = cache[id(run)].get(response)
            if values is not None:
                out[start:start + run.n] = values / sd
        return out

    def signal(self, effect):
        return self.vector(lambda run: signal(effect, run))

    def linear(self, effect, keys=None):
        """Whitened columns of an effect's linear parameters."""
        tables = [columns(effect, run) for run in self.runs]
        law, _ = split_name(effect["name"])
        out = []
        for key in keys or LINEAR[law]:
            lookup = {id(run): {r: t[key] for r, t in table.items() if key in t}
                      for run, table in zip(self.runs, tables)}
            out.append(self.vector(lambda run: lookup[id(run)]))
        return out

    def shapes(self, effect):
        """Whitened derivatives of an effect's signal to its shape parameters."""
        out = []
        for key, step in SHAPE_STEPS.items():
            if key in effect:
                width = step if key.endswith("_rad") else step * effect[key]
                up, down = dict(effect), dict(effect)
                up[key], down[key] = effect[key] + width, effect[key] - width
                out.append((self.signal(up) - self.signal(down)) / (2 * width))
        return out

    def setup(self, known):
        """Whitened set-up columns, each of its own record and response."""
        out = []
        for run, response, start, sd in self.parts:
            block = list(setup_columns(run, response))
            if run.kind == "ballbar" and not run.knows_place():
                for effect in known:                 # a wave seen at an unknown place has a free phase
                    if split_name(effect["name"])[0] in WAVE_LAWS:
                        turned = dict(effect, phase_rad=effect["phase_rad"] + np.pi / 2)
                        block += [signal(e, run)[response] for e in (effect, turned) if response in signal(e, run)]
            if run.kind == "plate" and run.setup.get("turn_urad"):
                # The plate lies turned: one free column for both responses.
                if response == run.responses[0]:
                    turn = {"name": "rotation." + ".".join(sorted(run.pos))}
                    out.append(self.vector(lambda other: {r: t["urad"] for r, t in columns(turn, run).items()}
                                           if other is run else {}))
            for column in block:
                vector = np.zeros(self.n)
                vector[start:start + run.n] = column / sd
                out.append(vector)
        return out


def basis(vectors):
    """Orthonormal basis of the vectors; near-dependent ones are left out."""
    if not vectors:
        return np.zeros((0, 0))
    matrix = np.array(vectors).T
    lengths = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, lengths > 1e-12] / lengths[lengths > 1e-12]
    if matrix.shape[1] == 0:
        return np.zeros((matrix.shape[0], 0))
    u, s, _ = np.linalg.svd(matrix, full_matrices=False)
    return u[:, s > 1e-7 * s[0]]


def without(q, vector):
    """The part of a vector (or of columns) outside a basis."""
    if q.size == 0:
        return vector
    vector = vector - q @ (q.T @ vector)
    return vector - q @ (q.T @ vector)


class Visibility:
    """What the training records of a case can show."""

    def __init__(self, runs, known, hidden):
        self.stack, self.known, self.hidden = Stack(runs), known, hidden
        self.fixed = self.stack.setup(known)
        for effect in known:
            keys = [k for k in LINEAR[split_name(effect["name"])[0]] if effect.get(k)]
            self.fixed += self.stack.linear(effect, keys)
        self._q = {}

    def others(self, effect):
        """Basis of all that is free beside one hidden effect."""
        key = id(effect)
        if key not in self._q:
            vectors = list(self.fixed)
            for other in self.hidden:
                if other is not effect:
                    keys = [k for k in LINEAR[split_name(other["name"])[0]] if other.get(k)]
                    vectors += self.stack.linear(other, keys) + self.stack.shapes(other)
            self._q[key] = basis(vectors)
        return self._q[key]

    def sensor_inflation(self, effect):
        """Factor on the noise because the logged sensor carries noise of its own."""
        if split_name(effect["name"])[0] not in SENSOR_LAWS:
            return 1.0
        noise = sd = 0.0
        for run, response, _, row_sd in self.stack.parts:
            slope = effect.get("um_per_K") or effect.get("ppm_per_K", 0.0) * max(
                [np.max(np.abs(p)) for p in run.pos.values()] or [0.0]) / 1000.0
            spread = np.hypot(run.sensor_noise, run.sensor_step / np.sqrt(12)) * (1.5 if effect.get("minus") else 1.0)
            if split_name(effect["name"])[0] == "thermal_lag":
                spread *= 0.3                        # the lag smooths the sensor's noise
            noise += run.n * (slope * spread) ** 2
            sd += run.n * row_sd ** 2
        return float(np.sqrt(1 + noise / sd))

    def snr(self, effect):
        """Norm of the effect's column outside all other free terms, in sigma."""
        own = without(self.others(effect), self.stack.signal(effect))
        return float(np.linalg.norm(own)) / self.sensor_inflation(effect)

    def left_over(self, effect, rival):
        """Squared sigma of `effect` that a rival with free amplitude leaves."""
        q = self.others(effect)
        own = without(q, self.stack.signal(effect))
        keys = [k for k in LINEAR[split_name(rival["name"])[0]] if rival.get(k)]
        columns_ = [without(q, c) for c in self.stack.linear(rival, keys or None)]
        return float(np.sum(without(basis(columns_), own) ** 2))

    def has_alias(self, effect):
        """Whether a wave of quite another period explains a hidden wave within chance.

        Few targets far apart cannot tell a screw's period: then nobody can.
        """
        law, axes = split_name(effect["name"])
        if law not in ("screw_periodic", "screw_slope"):
            return False
        place, weight = np.zeros(self.stack.n), np.zeros(self.stack.n)
        for run, response, start, sd in self.stack.parts:
            if axes[0] not in run.pos or np.ptp(run.pos[axes[0]]) == 0:
                continue
            if run.kind == "ballbar":
                if run.knows_place():
                    return False                    # a circle's rows stand close enough
            elif response == f"error.{axes[0]}":
                place[start:start + run.n] = run.pos[axes[0]]
                weight[start:start + run.n] = (run.pos[axes[0]] / 1000.0 if law == "screw_slope" else 1.0) / sd
        rows = np.flatnonzero(weight)
        if len(rows) == 0 or len(np.unique(np.round(place[rows], 1))) > 100:
            return False
        q = self.others(effect)
        own = without(q, self.stack.signal(effect))
        size, span, true = float(own @ own), float(np.ptp(place[rows])), 1.0 / effect["period_mm"]
        part, q_rows = own[rows], q[rows] if q.size else np.zeros((len(rows), 1))

        def left_at(frequencies):
            out = []
            for block in np.array_split(frequencies, max(1, len(frequencies) // 300)):
                angle = 2 * np.pi * np.outer(place[rows], block)
                c, s = np.cos(angle) * weight[rows, None], np.sin(angle) * weight[rows, None]
                cq, sq = q_rows.T @ c, q_rows.T @ s
                a, b, d = (c * c).sum(0) - (cq * cq).sum(0), (c * s).sum(0) - (cq * sq).sum(0), (s * s).sum(0) - (sq * sq).sum(0)
                u, v = part @ c, part @ s
                out.append(size - (d * u * u - 2 * b * u * v + a * v * v) / np.maximum(a * d - b * b, 1e-9 * a * d + 1e-300))
            return np.concatenate(out)
        grid = np.arange(1 / 60.0, 2.0, 0.3 / span)
        grid = grid[np.abs(grid - true) > 1.5 / span]
        near = grid[left_at(grid) < 0.15 * size + RIVAL_LIMIT]
        if len(near) == 0:
            return False
        fine = (near[:, None] + np.linspace(-0.15, 0.15, 13) / span).ravel()
        return bool(np.min(left_at(fine)) < RIVAL_LIMIT)

    def extra_snr(self, extra):
        """Sigma of an error without a name, outside set-up and known effects."""
        vector = self.stack.vector(lambda run: {r: extra(run, r) for r in run.responses})
        return float(np.linalg.norm(without(basis(self.fixed), vector)))

    def rivals(self, effect):
        """Names of other laws that explain one hidden effect within chance."""
        q = self.others(effect)
        own = without(q, self.stack.signal(effect))
        size = float(own @ own)
        found = set()
        for rival in candidate_effects(self.stack.runs, effect):
            name = rival["name"]
            if name == effect["name"] or name in found or same_by_contract(effect["name"], name):
                continue
            law = split_name(name)[0]
            column = without(q, self.stack.linear(rival, LINEAR[law][:1])[0])
            power = float(column @ column)
            if power < 1e-9 * max(size, 1e-12):
                continue
            amount = float(column @ own) / power
            left = size - amount ** 2 * power
            if left < RIVAL_LIMIT and left < 0.25 * size and abs(amount) < PLAUSIBLE.get(law, np.inf):
                found.add(name)
        return sorted(found)


def same_by_contract(one, other):
    """Names that "Details that decide" treats as one effect."""
    (law, axes), (law2, axes2) = split_name(one), split_name(other)
    if law == law2 and law in ("squareness", "rotation"):
        return sorted(axes) == sorted(axes2)
    if law == law2 == "angular":                 # e = urad_per_m*p_B*p_C: the order of B and C is no matter
        return axes[0] == axes2[0] and sorted(axes[1:]) == sorted(axes2[1:])
    if {law, law2} == {"thermal_growth", "thermal_lag"}:
        return axes == axes2                     # where both fit equally, growth is given
    return False


def axes_of(runs):
    """Axes whose error a record reads, alone or through a circle."""
    out = set()
    for run in runs:
        for response in run.responses:
            axis = response.split(".")[1]
            out |= set(run.plane or []) if axis == "r" else {axis}
    return sorted(out)


def candidate_effects(runs, near):
    """Effects of other laws that might stand for `near`, on a coarse grid of shapes."""
    law, near_axes = split_name(near["name"])
    force = any(r.responses[0].startswith("force") for r in runs)
    axes = axes_of(runs)
    if force:
        for axis in axes:
            for name in ("inertia", "friction_viscous", "friction_coulomb", "friction_asymmetric", "force_offset"):
                yield {"name": f"{name}.{axis}"}
        return
    if axes == []:
        return
    moving = sorted({a for run in runs for a in run.pos})
    sensors = sorted({s for run in runs for s in run.temps})
    # A law of one axis's error can only stand for errors of the same axis,
    # except in a circle, which reads both.
    circle = any(run.kind == "ballbar" for run in runs)
    for axis in [a for a in axes if circle or a in near_axes]:
        for name in ("scale", "reversal", "reversal_slope", "following_error", "acceleration_error", "stiffness", "coolant",
                     "spindle_speed", "probe_latency"):
            yield {"name": f"{name}.{axis}"}
        for length in (0.3, 1.0, 3.0):
            yield {"name": f"reversal_spike.{axis}", "length_mm": length}
        for tau in (60.0, 200.0, 600.0, 1200.0, 2400.0, 5000.0, 10000.0, 30000.0):
            yield {"name": f"warm_up.{axis}", "tau_s": tau}
        for channel in sorted({c for run in runs for c in run.channels}):
            yield {"name": f"channel.{axis}.{channel}"}
        for other in moving:
            if other != axis:
                yield {"name": f"squareness.{axis}.{other}"}
                yield {"name": "rotation." + ".".join(sorted((axis, other)))}
                yield {"name": f"angular.{axis}.{axis}.{other}"}
        if law not in MAP_LAWS + WAVE_LAWS:
            for sensor in sensors:
                yield {"name": f"thermal_growth.{axis}", "sensor": sensor}
                yield {"name": f"thermal_expansion.{axis}", "sensor": sensor}
                for tau in (120.0, 600.0, 2000.0, 6000.0):
                    yield {"name": f"thermal_lag.{axis}", "sensor": sensor, "tau_s": tau}
        if law != "lost_counts":
            for run in runs:
                for row in range(4, run.n - 4, max(1, run.n // 25)):
                    yield {"name": f"lost_counts.{axis}", "at_s": float(run.t[row])}
