"""The laws of tools/guide/reference/effects.md, written from their formulas alone.

`Run` holds one record as it truly happened.  `columns` gives, for every
linear parameter of an effect, the error it makes per unit in each response.
Units: error µm, position mm, time s, speed mm/s, temperature degC.
"""
import numpy as np

# Linear parameters of each law (key without the axes).  All other numbers
# of an effect shape its column.
LINEAR = {
    "offset": ("um",), "scale": ("ppm",), "position_map": ("um",), "screw_periodic": ("um",),
    "subdivision": ("um",), "reversal": ("um",), "reversal_slope": ("um_per_m",),
    "screw_slope": ("um_per_m",), "reversal_spike": ("um",), "straightness": ("um",),
    "squareness": ("urad",), "rotation": ("urad",), "angular": ("urad_per_m",),
    "thermal_expansion": ("ppm_per_K",), "thermal_growth": ("um_per_K", "um_per_K2"),
    "thermal_lag": ("um_per_K", "um_per_K2"), "warm_up": ("um",), "coolant": ("um",),
    "spindle_speed": ("um_per_krpm", "um_per_krpm2"), "following_error": ("ms",),
    "acceleration_error": ("um_per_m_s2",), "stiffness": ("um_per_N",), "lost_counts": ("um",),
    "probe_latency": ("us",), "probe_lobing": ("um",), "form_bump": ("um",), "channel": ("gain",),
    "inertia": ("kg",), "friction_viscous": ("N_s_per_m",), "friction_coulomb": ("N",),
    "friction_asymmetric": ("N_s_per_m",), "force_offset": ("N",),
}
FORCE_LAWS = ("inertia", "friction_viscous", "friction_coulomb", "friction_asymmetric", "force_offset")
SENSOR_LAWS = ("thermal_expansion", "thermal_growth", "thermal_lag")
WAVE_LAWS = ("screw_periodic", "subdivision", "screw_slope", "probe_lobing")
MAP_LAWS = ("position_map", "straightness")


class Run:
    """One record as it truly happened, before gauges round anything."""

    def __init__(self, name, kind, t):
        self.name, self.kind, self.t = name, kind, np.asarray(t, float)
        self.n = len(self.t)
        self.pos, self.dir, self.vel, self.acc, self.load = {}, {}, {}, {}, {}
        self.temps, self.channels = {}, {}
        self.rpm = self.wet = self.angle = self.cycle = None
        self.responses = []          # "error.x", "error.r", "force.x"
        self.logged = set()          # optional columns written: "time", "cycle", "position", ...
        self.radius = self.plane = self.centre = self.turns = self.over = None
        self.tell_centre = False     # whether centre_mm is written
        self.count_um = self.zero = None
        self.noise = {}              # response -> dict(sigma, phi, step)
        self.sensor_noise, self.sensor_step, self.time_step = 0.02, 0.0625, 0.01
        self.place_repeats = 1       # repeats at the same place and direction
        self.setup = {}              # set-up values that were drawn
        self.measured = {}           # response -> numbers as the gauge gives them

    def keep_rows(self, keep):
        """Keep only the chosen rows (an interrupted run)."""
        self.t = self.t[keep]
        self.n = len(self.t)
        for table in (self.pos, self.dir, self.vel, self.acc, self.load, self.temps, self.channels):
            for key in table:
                table[key] = table[key][keep]
        for key in ("rpm", "wet", "angle", "cycle"):
            if getattr(self, key) is not None:
                setattr(self, key, getattr(self, key)[keep])

    def knows_place(self):
        """Whether the record says where its circle is on the axes."""
        return self.kind != "ballbar" or self.tell_centre or "position" in self.logged


def split_name(name):
    """('screw_periodic', ['x']) of 'screw_periodic.x'."""
    parts = name.split(".")
    return parts[0], parts[1:]


def zeros(run):
    return np.zeros(run.n)


def lag_response(t, inputs, tau_s, start=None):
    """First-order lag, input linear between rows, in equilibrium at the first row.

    `inputs` is one row per time; `start` overrides the first state.
    """
    out = np.empty_like(inputs, dtype=float)
    state = inputs[0] if start is None else start
    out[0] = state
    for i in range(1, len(t)):
        step = t[i] - t[i - 1]
        if step > 0:
            slope = (inputs[i] - inputs[i - 1]) / step
            state = (inputs[i] - slope * tau_s
                     + (state - inputs[i - 1] + slope * tau_s) * np.exp(-step / tau_s))
        out[i] = state
    return out


def spike_travel(run, axis):
    """Travel since the last row of the old direction; inf before the first turn.

    In a positioning record the axis turned `over` mm beyond the end target.
    """
    pos, way = run.pos[axis], run.dir[axis]
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(pos)))))
    out = np.full(run.n, np.inf)
    beyond = run.over or 0.0
    origin = None
    for i in range(1, run.n):
        if way[i] != way[i - 1] and way[i] != 0 and way[i - 1] != 0:
            origin = travel[i - 1] - beyond
        if origin is not None:
            out[i] = travel[i] - origin
    return out


def temperature_difference(effect, run):
    """ΔT of an effect at each row of a run; None if the run lacks the sensor."""
    if effect["sensor"] not in run.temps:
        return None
    warm = run.temps[effect["sensor"]]
    if effect.get("minus"):
        return None if effect["minus"] not in run.temps else warm - run.temps[effect["minus"]]
    return warm - effect.get("reference_degC", 20.0)


def hat_values(pos, knots, values):
    """Linear between knots, constant beyond the end knots."""
    return np.interp(pos, knots, values)


def axis_columns(effect, run):
    """{linear parameter: {axis: column}}: the error of each axis per unit."""
    law, axes = split_name(effect["name"])
    keys = LINEAR[law]
    a = axes[0] if axes else None
    p = run.pos.get(a)
    moves = p is not None
    b_pos = run.pos.get(axes[1]) if len(axes) > 1 else None
    one = lambda column: {keys[0]: {a: column}}
    if law == "offset":
        return one(np.ones(run.n))
    if law == "scale" and moves:
        return one(p / 1000.0)
    if law == "position_map" and moves:
        return one(hat_values(p, effect["knots_mm"], effect["um"]))
    if law in ("screw_periodic", "subdivision", "screw_slope") and moves:
        period = effect["period_um"] / 1000.0 if law == "subdivision" else effect["period_mm"]
        wave = np.sin(2 * np.pi * p / period + effect["phase_rad"])
        return one(wave * p / 1000.0 if law == "screw_slope" else wave)
    if law == "reversal" and a in run.dir:
        return one(run.dir[a] / 2.0)
    if law == "reversal_slope" and a in run.dir and moves:
        return one(p / 1000.0 * run.dir[a] / 2.0)
    if law == "reversal_spike" and a in run.dir and moves:
        return one(run.dir[a] * np.exp(-spike_travel(run, a) / effect["length_mm"]))
    if law == "straightness" and b_pos is not None:
        return one(hat_values(b_pos, effect["knots_mm"], effect["um"]))
    if law == "squareness" and b_pos is not None:
        return one(b_pos / 1000.0)
    if law == "rotation":
        out = {}
        if b_pos is not None:
            out[a] = -b_pos / 1000.0
        if moves:
            out[axes[1]] = p / 1000.0
        return {keys[0]: out}
    if law == "angular" and b_pos is not None and axes[2] in run.pos:
        return one(b_pos * run.pos[axes[2]] / 1e6)
    if law in SENSOR_LAWS:
        warm = temperature_difference(effect, run)
        if warm is None:
            return {}
        if law == "thermal_expansion":
            return one(warm * p / 1000.0) if moves else {}
        if law == "thermal_lag":
            warm = lag_response(run.t, warm, effect["tau_s"])
        return {"um_per_K": {a: warm}, "um_per_K2": {a: warm ** 2}}
    if law == "warm_up":
        return one(1.0 - np.exp(-run.t / effect["tau_s"]))
    if law == "coolant" and run.wet is not None:
        return one((run.wet > 0).astype(float))
    if law == "spindle_speed" and run.rpm is not None:
        krpm = run.rpm / 1000.0
        return {"um_per_krpm": {a: krpm}, "um_per_krpm2": {a: krpm ** 2}}
    if law == "following_error" and a in run.vel and run.kind != "probing":
        return one(run.vel[a])
    if law == "acceleration_error" and a in run.acc:
        return one(run.acc[a] / 1000.0)
    if law == "stiffness" and a in run.load:
        return one(run.load[a])
    if law == "lost_counts":
        return one((run.t >= effect["at_s"]).astype(float))
    if law == "probe_latency" and a in run.vel and run.kind == "probing":
        return one(run.vel[a] / 1000.0)
    if law == "channel" and axes[1] in run.channels:
        return one(run.channels[axes[1]])
    if law in FORCE_LAWS and a in run.vel:
        speed = run.vel[a]
        column = {"inertia": run.acc[a] / 1000.0, "friction_viscous": speed / 1000.0,
                  "friction_coulomb": np.sign(speed), "friction_asymmetric": np.abs(speed) / 1000.0,
                  "force_offset": np.ones(run.n)}[law]
        return one(column)
    return {}


def radial_columns(effect, run):
    """{linear parameter: column} of the laws that act on error.r by themselves."""
    if run.angle is None:
        return {}
    law = effect["name"]
    if law == "probe_lobing":
        return {"um": np.cos(effect["lobes"] * run.angle + effect["phase_rad"])}
    if law == "form_bump":
        off = (run.angle - effect["centre_rad"] + np.pi) % (2 * np.pi) - np.pi
        bump = (1 + np.cos(2 * np.pi * off / effect["width_rad"])) / 2
        return {"um": np.where(np.abs(off) <= effect["width_rad"] / 2, bump, 0.0)}
    return {}


def columns(effect, run):
    """{response: {linear parameter: column}} of an effect in a run."""
    law, _ = split_name(effect["name"])
    out = {}
    if law in ("probe_lobing", "form_bump"):
        for response in run.responses:
            if response == "error.r" and run.kind in ("probing", "part"):
                out[response] = radial_columns(effect, run)
        return out
    by_axis = axis_columns(effect, run)
    for response in run.responses:
        quantity, axis = response.split(".")[:2]
        if (quantity == "force") != (law in FORCE_LAWS):
            continue
        for key, table in by_axis.items():
            if quantity == "error" and axis == "r":
                if run.kind != "ballbar":
                    continue
                first, second = run.plane
                if first not in table and second not in table:
                    continue
                column = (table.get(first, 0.0) * np.cos(run.angle)
                          + table.get(second, 0.0) * np.sin(run.angle))
            elif axis in table:
                column = table[axis]
            else:
                continue
            out.setdefault(response, {})[key] = column
    return out


def amplitudes(effect):
    """{linear parameter: amplitude}; a map's amplitude is one common factor."""
    law, _ = split_name(effect["name"])
    if law in MAP_LAWS:
        return {"um": 1.0}
    return {key: effect.get(key, 0.0) for key in LINEAR[law]}


def signal(effect, run):
    """{response: error} that an effect makes in a run."""
    sizes = amplitudes(effect)
    out = {}
    for response, table in columns(effect, run).items():
        out[response] = sum(sizes[key] * column for key, column in table.items())
    return out


def total(effects, run):
    """{response: summed error of the effects}."""
    out = {response: zeros(run) for response in run.responses}
    for effect in effects:
        for response, values in signal(effect, run).items():
            out[response] = out[response] + values
    return out


def setup_columns(run, response):
    """Columns of the set-up's free terms in one response (tools/guide/contributor/estimate.md)."""
    if response.startswith("force"):
        return []
    out = [np.ones(run.n)]
    hours = (run.t - run.t[0]) / 3600.0
    if response == "error.r":
        out += [np.cos(run.angle), np.sin(run.angle)]
    elif run.kind in ("positioning", "drift"):
        out.append(hours)
        if run.setup.get("jump_row"):
            out.append((np.arange(run.n) >= run.setup["jump_row"]).astype(float))
    return out
