"""Cases of the shop judge: a plan of measurements, a true machine, what is hidden.

`make_case(class, seed)` is deterministic.  Sizes are those of usual machine
tools: ISO 230-2 and -3 reports, ballbar guides, makers' data sheets.
"""
import copy

import numpy as np

import shop_records as rec
from shop_laws import MAP_LAWS, SENSOR_LAWS, WAVE_LAWS, amplitudes, split_name
from shop_records import log_uniform, pick, signed
from shop_stats import Visibility, axes_of

CLASSES = ("hidden", "many", "nothing", "nameless", "mistakes")
SMALL = 2.0          # sigma: below, an effect is not required
DETECTABLE = 5.0     # sigma: from here on, an effect must be found
MODEL_ERROR = 0.10   # standard deviation of the amplitudes in machine.toml


class Case:
    """Records, truth and what a right verdict says."""

    def __init__(self, kind, seed):
        self.kind, self.seed = kind, seed
        self.train, self.holdout = [], []
        self.known, self.model, self.hidden = [], [], []
        self.snr, self.rivals = [], []
        self.extra = None            # error that no law describes
        self.extra_name, self.extra_snr = "", 0.0
        self.parts = {}              # names that truly describe a part of it, with their shape
        self.mistake = None          # {"record", "what", ...}
        self.scenario, self.rng = "", None

    def truth(self):
        """The hidden truth as a plain document."""
        return {"class": self.kind, "seed": self.seed, "scenario": self.scenario, "hidden": self.hidden,
                "snr": [round(s, 2) for s in self.snr], "rivals": self.rivals, "known": self.known,
                "nameless": self.extra_name, "nameless_snr": round(self.extra_snr, 2),
                "names_that_describe_a_part": self.parts, "mistake": self.mistake,
                "set_up": {r.name: r.setup for r in self.train + self.holdout},
                "noise": {r.name: r.noise for r in self.train + self.holdout}}


# ---------------------------------------------------------------- plans

def plan_runs(shop, scenario):
    """What the shop measures: a list of (maker, arguments), used again on another day."""
    rng = shop.rng
    axes = shop.axes
    plan = []
    if scenario == "line":
        axis = pick(rng, axes)
        second = pick(rng, [a for a in axes if a != axis]) if rng.random() < 0.2 else None
        plan.append((rec.line, {"axis": axis, "second": second, "long": rng.random() < 0.25}))
        if rng.random() < 0.5:
            plan.append((rec.line, {"axis": axis, "second": second}))
    elif scenario == "lines":
        for axis in axes[:int(rng.integers(2, len(axes) + 1))]:
            plan.append((rec.line, {"axis": axis}))
    elif scenario == "heights":           # the same axis at two offsets: Abbe's error
        axis, other = axes[0], axes[-1]
        low, high = shop.travel[other]
        for share in (rng.uniform(0.02, 0.2), rng.uniform(0.75, 0.98)):
            plan.append((rec.line, {"axis": axis, "park": {other: round(low + share * (high - low), 1)}}))
    elif scenario in ("bars", "lines_bars"):
        plane = (axes[0], axes[1])
        if scenario == "lines_bars":
            for axis in plane:
                if rng.random() < 0.85:
                    plan.append((rec.line, {"axis": axis}))
        radius = float(pick(rng, [50, 100, 150, 150]))
        tell = pick(rng, ["centre", "centre", "positions", "positions", "nothing"])
        feeds = sorted({pick(rng, [250.0, 500.0, 1000.0, 2000.0, 4000.0]) for _ in range(int(rng.integers(1, 4)))})
        for feed in feeds:
            if rng.random() < 0.25:
                plan.append((rec.bar, {"plane": plane, "both": True, "feed": feed, "radius": radius, "tell": tell}))
            else:
                for way in (1, -1):
                    plan.append((rec.bar, {"plane": plane, "way": way, "feed": feed, "radius": radius, "tell": tell}))
    elif scenario == "drift":
        plan = [(rec.drift, {"channel": rng.random() < 0.4})] * int(rng.integers(1, 3))
    elif scenario == "plate":
        plan = [(rec.plate, {"turned": rng.random() < 0.3})] * int(rng.integers(1, 3))
    elif scenario == "dynamics":
        axis = pick(rng, axes)
        plan = [(rec.dynamics, {"axis": axis})] * int(rng.integers(1, 3))
    elif scenario == "feed_sweep":
        axis = pick(rng, axes)
        plan = [(rec.feed_sweep, {"axis": axis, "channel": rng.random() < 0.3})] * int(rng.integers(1, 3))
    elif scenario == "ring":
        plan = [(rec.ring, {"part": rng.random() < 0.5})] * int(rng.integers(1, 3))
    elif scenario == "probing":
        plan = [(rec.probing, {"axis": pick(rng, axes)})] * int(rng.integers(1, 3))
    elif scenario == "fine":
        axis = pick(rng, axes)
        plan = [(rec.line, {"axis": axis, "fine": True})]
        if rng.random() < 0.6:
            plan.append((rec.line, {"axis": axis}))
    elif scenario == "shop_floor":        # everything that was at hand
        plan += plan_runs(shop, "lines_bars") + [(rec.drift, {})]
    return plan


SCENARIOS = {
    "hidden": ["line", "line", "lines", "lines_bars", "lines_bars", "bars", "heights", "drift", "drift", "plate",
               "dynamics", "feed_sweep", "ring", "probing", "fine"],
    "many": ["lines", "lines_bars", "lines_bars", "drift", "plate", "shop_floor", "feed_sweep"],
    "nothing": ["line", "lines", "lines_bars", "bars", "heights", "drift", "plate", "dynamics", "feed_sweep", "ring",
                "probing", "fine", "shop_floor"],
}


def make_runs(shop, plan, tag):
    """Carry a plan out: fresh set-ups, temperatures and targets."""
    runs = []
    for i, (maker, arguments) in enumerate(plan):
        kind = maker.__name__.replace("_", "-")
        axis = arguments.get("axis", "")
        run = maker(shop, name=f"{tag}{i + 1}-{kind}{'-' + axis if axis else ''}", **arguments)
        runs.append(run)
    return runs


# ---------------------------------------------------------------- the true machine

def sensor_choice(shop, runs, differential=0.35):
    """Sensor fields of a thermal law: one sensor, a pair, or a stated reference.

    A sensor near the heat is likelier: what does not warm does not grow.
    """
    rng = shop.rng
    names = list(shop.sensors)
    moves = np.array([0.1 + max([np.ptp(r.temps[n]) for r in runs if n in r.temps], default=0.0) for n in names])
    out = {"sensor": names[int(rng.choice(len(names), p=moves / moves.sum()))]}
    if len(names) > 1 and rng.random() < differential:
        out["minus"] = pick(rng, [n for n in names if n != out["sensor"]])
    elif rng.random() < 0.7:
        out["reference_degC"] = 20.0
    return out


def knots_for(shop, axis, size):
    """A smooth map without constant and line, some five to nine knots."""
    rng = shop.rng
    low, high = shop.travel[axis]
    count = int(rng.integers(5, 10))
    knots = np.linspace(low, high, count)
    values = np.cumsum(rng.normal(0, 1, count))
    line = np.polyfit(knots, values, 1)
    values = values - np.polyval(line, knots)
    values = values * size / max(np.sqrt(np.mean(values ** 2)), 1e-9)
    return {"knots_mm": [round(float(k), 3) for k in knots], "um": [round(float(v), 4) for v in values]}


def one_effect(shop, law, axes, runs):
    """An effect of the law with a size that machines have."""
    rng, g = shop.rng, shop.grade
    name = ".".join([law] + list(axes))
    phase = float(rng.uniform(-np.pi, np.pi))
    span = float(np.median([r.t[-1] - r.t[0] for r in runs]))
    tau = float(np.clip(log_uniform(rng, 0.15, 0.9) * span, 60, 12000))
    out = {"name": name}
    if law == "scale":
        out["ppm"] = signed(rng, 3, 35) * g
    elif law == "position_map":
        out.update(knots_for(shop, axes[0], log_uniform(rng, 0.6, 4) * g))
    elif law == "straightness":
        out.update(knots_for(shop, axes[1], log_uniform(rng, 0.6, 4) * g))
    elif law == "screw_periodic":
        out.update(um=log_uniform(rng, 0.5, 4) * g, phase_rad=phase,
                   period_mm=float(pick(rng, [5, 6, 8, 10, 10, 12, 16, 20, 25, 32])))
    elif law == "screw_slope":
        out.update(um_per_m=log_uniform(rng, 3, 20) * g, phase_rad=phase, period_mm=10.0)
    elif law == "subdivision":
        out.update(um=log_uniform(rng, 0.15, 1.0), phase_rad=phase, period_um=float(pick(rng, [20, 40])))
    elif law == "reversal":
        out["um"] = (log_uniform(rng, 0.8, 8) if rng.random() < 0.85 else -log_uniform(rng, 0.8, 5)) * g
    elif law == "reversal_slope":
        out["um_per_m"] = signed(rng, 3, 25) * g
    elif law == "reversal_spike":
        out.update(um=signed(rng, 1, 6) * g, length_mm=log_uniform(rng, 0.4, 4))
    elif law in ("squareness", "rotation"):
        out["urad"] = signed(rng, 6, 50) * g
    elif law == "angular":
        out["urad_per_m"] = signed(rng, 20, 150) * g
    elif law == "thermal_expansion":
        out.update(ppm_per_K=signed(rng, 2, 13), **sensor_choice(shop, runs))
    elif law in ("thermal_growth", "thermal_lag"):
        out.update(um_per_K=signed(rng, 0.3, 6), um_per_K2=0.0, **sensor_choice(shop, runs))
        if law == "thermal_lag":
            out["tau_s"] = float(np.clip(tau, 200, 7200))
        elif rng.random() < 0.2:
            out["um_per_K2"] = signed(rng, 0.01, 0.08)
    elif law == "warm_up":
        out.update(um=signed(rng, 2, 15) * np.sqrt(g), tau_s=tau)
    elif law == "coolant":
        out["um"] = signed(rng, 0.6, 6)
    elif law == "spindle_speed":
        out.update(um_per_krpm=signed(rng, 0.1, 1.2), um_per_krpm2=signed(rng, 0.005, 0.05) if rng.random() < 0.4 else 0.0)
    elif law == "following_error":
        out["ms"] = signed(rng, 0.02, 0.3) if rng.random() < 0.5 else log_uniform(rng, 0.02, 0.3)
    elif law == "acceleration_error":
        out["um_per_m_s2"] = signed(rng, 1, 10)
    elif law == "stiffness":
        out["um_per_N"] = signed(rng, 0.003, 0.05)
    elif law == "lost_counts":
        run = pick(rng, runs)
        wide = np.flatnonzero(np.diff(run.t) > 2.5 * run.time_step) + 1    # the clock must tell the rows apart
        wide = wide[(wide >= run.n // 5) & (wide <= 4 * run.n // 5)]
        row = int(pick(rng, wide)) if len(wide) else run.n // 2
        count = pick(rng, [1.0, 1.0, 2.0, 5.0])
        out.update(um=count * int(rng.integers(1, 5)) * (1 if rng.random() < 0.5 else -1),
                   at_s=round(float((run.t[row - 1] + run.t[row]) / 2), 3))
        for other in runs:
            other.count_um = count
    elif law == "probe_latency":
        out["us"] = log_uniform(rng, 60, 900)
    elif law == "probe_lobing":
        out.update(um=log_uniform(rng, 0.4, 4), lobes=int(pick(rng, [2, 3, 3, 4, 5])), phase_rad=phase)
    elif law == "form_bump":
        out.update(um=signed(rng, 1.5, 12), centre_rad=float(rng.uniform(0.3, 5.9)), width_rad=log_uniform(rng, 0.3, 1.5))
    elif law == "channel":
        out["gain"] = signed(rng, 0.05, 0.6)
    elif law == "inertia":
        out["kg"] = log_uniform(rng, 60, 900)
    elif law == "friction_viscous":
        out["N_s_per_m"] = log_uniform(rng, 100, 3000)
    elif law == "friction_coulomb":
        out["N"] = log_uniform(rng, 20, 200)
    elif law == "friction_asymmetric":
        out["N_s_per_m"] = signed(rng, 50, 800)
    elif law == "force_offset":
        out["N"] = signed(rng, 5, 80)
    return {k: (float(f"{v:.6g}") if isinstance(v, float) else v) for k, v in out.items()}


def possible_laws(shop, runs):
    """(laws every such machine has, laws it may have), each as (law, axes)."""
    base, more = [], []
    for run in runs:
        place = run.knows_place()
        minutes = (run.t[-1] - run.t[0]) / 60.0
        if run.kind == "positioning":
            a = run.responses[0].split(".")[1]
            fine = float(np.ptp(run.pos[a])) < 5.0
            base += [("scale", (a,)), ("reversal", (a,))]
            if fine:
                more += [("subdivision", (a,))] * 3
                continue
            more += [("screw_periodic", (a,)), ("position_map", (a,)), ("reversal_slope", (a,)), ("screw_slope", (a,)),
                     ("thermal_expansion", (a,)), ("thermal_growth", (a,))]
            if (len(runs) == 1 or shop.session_clock) and not run.setup.get("jump_row"):
                more.append(("lost_counts", (a,)))
            if minutes > 8:
                more += [("warm_up", (a,)), ("thermal_lag", (a,))]
            for response in run.responses[1:]:
                b = response.split(".")[1]
                base.append(("squareness", (b, a)))
                more += [("straightness", (b, a))] * 2
            parked = [b for b in run.pos if b != a]
            more += [("angular", (a, a, b)) for b in parked] * 4
        elif run.kind == "ballbar":
            a, b = run.plane
            base += [("scale", (a,)), ("scale", (b,)), ("reversal", (a,)), ("reversal", (b,)), ("squareness", (a, b))]
            both_ways = any(r.kind == "ballbar" and np.any(np.diff(r.cycle)) for r in runs)
            for axis in (a, b):
                more.append(("following_error", (axis,)))
                if place:
                    more += [("screw_periodic", (axis,)), ("reversal_slope", (axis,))]
                if not both_ways:
                    more += [("reversal_spike", (axis,))] * 2
        elif run.kind == "drift":
            for response in run.responses:
                a = response.split(".")[1]
                base += [("thermal_growth", (a,))]
                more += [("thermal_lag", (a,)), ("thermal_growth", (a,)), ("spindle_speed", (a,)), ("coolant", (a,)),
                         ("warm_up", (a,))] + [("channel", (a, c)) for c in run.channels]
        elif run.kind == "plate":
            a, b = sorted(run.pos)
            base += [("scale", (a,)), ("scale", (b,)), ("squareness", (a, b)), ("reversal", (a,))]
            more += [("straightness", (a, b)), ("straightness", (b, a)), ("angular", (a, a, b)), ("angular", (b, b, a)),
                     ("thermal_expansion", (a,)), ("thermal_expansion", (b,)), ("reversal", (b,)), ("position_map", (a,)),
                     ("rotation", (a, b))]
        elif run.kind == "dynamics":
            a = run.responses[0].split(".")[1]
            base += [("inertia", (a,)), ("friction_coulomb", (a,))]
            more += [("friction_viscous", (a,)), ("friction_asymmetric", (a,)), ("force_offset", (a,))]
        elif run.kind == "feed_sweep":
            a = run.responses[0].split(".")[1]
            base += [("scale", (a,)), ("reversal", (a,))]
            more += [("following_error", (a,)), ("acceleration_error", (a,)), ("stiffness", (a,))] * 2 + [("screw_periodic", (a,))]
            more += [("channel", (a, c)) for c in run.channels]
        elif run.kind in ("probing", "part") and run.angle is not None:
            more += [("probe_lobing", ()), ("form_bump", ())]
        elif run.kind == "probing":
            a = run.responses[0].split(".")[1]
            base += [("scale", (a,)), ("reversal", (a,))]
            more += [("probe_latency", (a,))]
    return sorted(set(base)), more


def true_machine(shop, runs, extra_count, hide):
    """(all effects of the machine, indices that are hidden)."""
    rng = shop.rng
    base, more = possible_laws(shop, runs)
    chosen = [key for key in base if rng.random() < 0.9]
    need = extra_count + (hide if not chosen else 0)
    tries = 0
    while more and need > 0 and tries < 60:
        tries += 1
        key = pick(rng, more)
        if key in chosen and key[0] not in ("thermal_growth", "thermal_lag", "probe_lobing"):
            continue
        thermal = [c for c in chosen if c[0] in SENSOR_LAWS + ("warm_up",) and c[1][:1] == key[1][:1]]
        if key[0] in SENSOR_LAWS + ("warm_up",) and len(thermal) >= 2:
            continue
        if sum(c[0] in ("lost_counts", "probe_lobing", "form_bump") for c in chosen) >= 2:
            continue
        if key[0] == "screw_slope" and ("screw_periodic", key[1]) not in chosen:
            chosen.append(("screw_periodic", key[1]))
        if key[0] == "reversal_slope" and ("reversal", key[1]) not in chosen:
            chosen.append(("reversal", key[1]))
        chosen.append(key)
        need -= 1
    effects = [one_effect(shop, law, axes, runs) for law, axes in chosen]
    for effect in effects:                       # a wave and its growth have one period
        law, axes = split_name(effect["name"])
        if law == "screw_slope":
            for other in effects:
                if other["name"] == f"screw_periodic.{axes[0]}":
                    effect["period_mm"] = other["period_mm"]
                    if rng.random() < 0.7:               # wear keeps the wave's phase
                        effect["phase_rad"] = other["phase_rad"]
    seen, unique = set(), []
    for effect in effects:                       # the same name twice only with another sensor or shape
        law, _ = split_name(effect["name"])
        mark = (effect["name"], effect.get("sensor"), effect.get("minus"), effect.get("lobes"))
        if mark not in seen:
            seen.add(mark)
            unique.append(effect)
    order = rng.permutation(len(unique))
    laws_added = [i for i in order if (split_name(unique[i]["name"])[0], tuple(split_name(unique[i]["name"])[1])) not in base]
    # Hide the rarer laws more often than the ones every machine has.
    weights = [i for i in laws_added] * 3 + [i for i in order]
    hidden = []
    while len(hidden) < min(hide, len(unique)) and weights:
        i = int(pick(rng, weights))
        if i not in hidden:
            hidden.append(i)
        weights = [w for w in weights if w != i]
    # A step that the model knows already is no error of a machine that was homed since.
    kept = [i for i, e in enumerate(unique) if i in hidden or not e["name"].startswith("lost_counts")]
    return [unique[i] for i in kept], [kept.index(i) for i in hidden]


def model_of(shop, known):
    """machine.toml's effects: the known ones, amplitudes some 10 % off."""
    rng, out = shop.rng, []
    for effect in known:
        copy_ = copy.deepcopy(effect)
        for key in amplitudes(effect):
            factor = 1 + MODEL_ERROR * float(np.clip(rng.normal(), -2.5, 2.5))
            if isinstance(copy_.get(key), list):
                copy_[key] = [round(v * factor, 4) for v in copy_[key]]
            elif copy_.get(key):
                copy_[key] = float(f"{copy_[key] * factor:.5g}")
        out.append(copy_)
    return out


def settle_map_lines(effects, runs):
    """Take constant and line out of each map over the training rows, as the contract says.

    A circle of unknown centre says nothing of a map's line: only rows whose place is known count.
    """
    for effect in effects:
        law, axes = split_name(effect["name"])
        if law in MAP_LAWS:
            axis = axes[-1]
            placed = [r for r in runs if r.kind != "ballbar" or r.knows_place()]
            rows = [r.pos[axis] for r in placed if axis in r.pos and np.ptp(r.pos[axis]) > 0
                    and any(x in (f"error.{axes[0]}", "error.r") for x in r.responses)]
            if not rows:
                continue
            p = np.concatenate(rows)
            shape = np.interp(p, effect["knots_mm"], effect["um"])
            fit = np.polyfit(p, shape, 1)
            effect["um"] = [round(float(v - np.polyval(fit, k)), 4) for k, v in zip(effect["knots_mm"], effect["um"])]


def share_zeros(shop, runs):
    """Sometimes the gauges stay where they are: the records share their zero by name."""
    rng = shop.rng
    groups = {}
    for run in runs:
        groups.setdefault((run.kind, tuple(run.responses)), []).append(run)
    for (kind, _), group in groups.items():
        if rng.random() < 0.15 and kind in ("drift", "feed_sweep"):
            for run in group:
                run.zero = f"{kind}-{shop.day}"
                run.setup["zero_um"] = dict(group[0].setup["zero_um"])
        elif rng.random() < 0.2:
            for run in group:
                run.zero = f"{run.name}-{shop.day}"


def build(case, shop, plan, extra_count, hide, wish_open=0.2):
    """Draw runs and machine until the hidden effects suit the class; True when done."""
    rng = shop.rng
    for attempt in range(40):
        shop.clock = 0.0
        train = make_runs(shop, plan, "a")
        effects, hidden_at = true_machine(shop, train, extra_count, hide)
        if len(hidden_at) < hide or not effects and hide:
            continue
        settle_map_lines(effects, train)
        hidden = [effects[i] for i in hidden_at]
        known = [e for i, e in enumerate(effects) if i not in hidden_at]
        view = Visibility(train, known, hidden)
        snr = [view.snr(e) for e in hidden]
        if any(s < SMALL for s in snr) and rng.random() < 0.9:
            continue
        if any(s < DETECTABLE for s in snr) and rng.random() < 0.6:
            continue
        if any(view.has_alias(e) for e in hidden):
            continue
        rivals = [view.rivals(e) if s >= SMALL else [] for e, s in zip(hidden, snr)]
        if any(rivals) and rng.random() > wish_open:
            continue
        shop.new_day()
        later = [p for p in plan]
        if len(later) > 3:
            later = [later[i] for i in sorted(rng.choice(len(later), 3, replace=False))]
        case.train, case.holdout = train, make_runs(shop, later, "b")
        case.known, case.hidden, case.snr, case.rivals = known, hidden, snr, rivals
        case.model = model_of(shop, known)
        share_zeros(shop, case.train)
        for run in case.train + case.holdout:
            if run.kind == "positioning" and not run.count_um and rng.random() < 0.15:
                run.count_um = pick(rng, [0.5, 1.0, 2.0])
        no_clock = not any(split_name(e["name"])[0] in ("warm_up", "thermal_lag", "lost_counts", "following_error")
                           for e in effects)
        for run in case.train:
            if no_clock and case.kind == "nothing" and run.kind == "positioning" and rng.random() < 0.15:
                run.logged.discard("time")
        return True
    return False


def finish(case):
    """Read all gauges."""
    for run in case.train + case.holdout:
        rec.measure(run, case.known + case.hidden, case.extra, case.rng)


def make_case(kind, seed):
    """The case of a class and a seed."""
    import shop_nameless
    import shop_mistakes
    for again in range(80):
        rng = np.random.default_rng([CLASSES.index(kind), seed, again])
        case = Case(kind, seed)
        case.rng, case.attempt = rng, again
        shop = rec.Shop(rng)
        if kind == "nameless":
            done = shop_nameless.build_nameless(case, shop)
        elif kind == "mistakes":
            done = shop_mistakes.build_mistake(case, shop)
        else:
            case.scenario = pick(rng, SCENARIOS[kind])
            plan = plan_runs(shop, case.scenario)
            if kind == "hidden":
                done = build(case, shop, plan, int(rng.integers(1, 4)), 1 if rng.random() < 0.6 else 2)
            elif kind == "many":
                done = build(case, shop, plan, int(rng.integers(2, 7)), int(rng.integers(3, 8)), 0.5)
            else:
                done = build(case, shop, plan, int(rng.integers(0, 4)), 0)
            if done:
                finish(case)
        if done:
            return case
    raise RuntimeError(f"no case for {kind} seed {seed}")
