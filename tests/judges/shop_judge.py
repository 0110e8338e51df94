"""Scores a verdict of `rtecctl reconcile` against a case's hidden truth.

These answers count as right too, and no others:
another sensor among the alternatives, squareness and rotation of one pair of
axes, growth for a lag that fits equally, and names that the data cannot tell
apart if the verdict lists the true one beside it.
"""
import numpy as np

from shop_cases import DETECTABLE, SMALL
from shop_laws import LINEAR, MAP_LAWS, SENSOR_LAWS, signal, split_name, total
from shop_nameless import SMALL_SHAPE
from shop_stats import RIVAL_LIMIT, Stack, Visibility, basis, same_by_contract, without

WORSE = -0.25    # gap closed on the hold-out below which a name describes no part

# Values no machine has: (law or "*", parameter) -> (low, high).
BOUNDS = {("*", "period_mm"): (0.5, 60), ("*", "period_um"): (1, 200), ("scale", "ppm"): (-1000, 1000),
          ("thermal_growth", "um_per_K"): (-60, 60), ("thermal_lag", "um_per_K"): (-60, 60),
          ("thermal_expansion", "ppm_per_K"): (-60, 60), ("*", "tau_s"): (0.01, 3e5),
          ("reversal_spike", "length_mm"): (1e-4, 100), ("reversal_spike", "um"): (-200, 200),
          ("reversal", "um"): (-500, 500), ("screw_periodic", "um"): (-200, 200), ("warm_up", "um"): (-500, 500),
          ("squareness", "urad"): (-5000, 5000), ("following_error", "ms"): (-100, 100),
          ("inertia", "kg"): (0, 1e5), ("friction_viscous", "N_s_per_m"): (0, 1e6), ("friction_coulomb", "N"): (0, 1e5),
          ("coolant", "um"): (-200, 200), ("probe_latency", "us"): (-1e5, 1e5), ("probe_lobing", "um"): (-200, 200)}


def read_parameters(entry):
    """{parameter: (value, low, high)} of a verdict's effect."""
    out = {}
    for key, p in (entry.get("parameters") or {}).items():
        if isinstance(p, dict):
            out[key] = (p.get("value"), p.get("low"), p.get("high"))
        else:
            out[key] = (p, None, None)
    return out


def entry_effect(entry):
    """A verdict's effect as the laws take it."""
    effect = {k: entry[k] for k in ("name", "sensor", "minus", "reference_degC", "knots_mm") if entry.get(k) is not None}
    for key, (value, _, _) in read_parameters(entry).items():
        if value is not None:
            effect[key] = value
    return effect


def complete(effect):
    """Whether the laws can evaluate this effect."""
    need = {"screw_periodic": ("period_mm", "phase_rad"), "subdivision": ("period_um", "phase_rad"),
            "screw_slope": ("period_mm", "phase_rad"), "reversal_spike": ("length_mm",), "thermal_lag": ("sensor", "tau_s"),
            "thermal_growth": ("sensor",), "thermal_expansion": ("sensor",), "warm_up": ("tau_s",),
            "lost_counts": ("at_s",), "probe_lobing": ("lobes", "phase_rad"),
            "form_bump": ("centre_rad", "width_rad"), "position_map": ("knots_mm", "um"), "straightness": ("knots_mm", "um")}
    law, axes = split_name(effect["name"])
    arity = {"probe_lobing": 0, "form_bump": 0, "straightness": 2, "squareness": 2, "rotation": 2, "angular": 3, "channel": 2}
    return law in LINEAR and len(axes) == arity.get(law, 1) and all(k in effect for k in need.get(law, ()))


def same_sensor(entry, truth):
    """+1 same sensor or pair, -1 the pair exchanged, 0 another."""
    pair, own = (entry.get("sensor"), entry.get("minus")), (truth.get("sensor"), truth.get("minus"))
    if pair == own:
        return 1
    return -1 if own[1] and pair == own[::-1] else 0


def alternatives(entry):
    """The rivals an entry lists, as dictionaries with at least a name."""
    out = []
    for rival in entry.get("alternatives") or []:
        out.append({"name": rival} if isinstance(rival, str) else dict({"name": entry["name"]}, **rival))
    return out


def compare(case, view, entry, truth, inflation, said):
    """How an entry of the verdict stands to one hidden effect.

    'right'; 'sensor': right, with another sensor or shape that fits as well;
    'rival': another name that fits as well, the true one listed beside it;
    'unlisted': the same, not listed; 'hedged': a name that does not fit as
    well, the true one listed in a `not_separable`; None: something else.
    """
    effect = entry_effect(entry)
    law, _ = split_name(effect["name"])
    own_law, _ = split_name(truth["name"])
    left = None

    def left_over():
        nonlocal left
        if left is None:
            left = view.left_over(truth, effect) / inflation ** 2 if complete(effect) else np.inf
        return left
    if law == own_law and (effect["name"] == truth["name"] or same_by_contract(effect["name"], truth["name"])):
        if law in SENSOR_LAWS:
            if same_sensor(effect, truth):
                return "right"
            if any(a["name"] == truth["name"] and same_sensor(a, truth) for a in alternatives(entry)):
                return "sensor"
            return "sensor" if left_over() < RIVAL_LIMIT else None
        for key in ("period_mm", "period_um", "lobes"):
            if key in truth:
                value = effect.get(key)
                if value is None or abs(value - truth[key]) > 0.02 * truth[key]:
                    return "sensor" if left_over() < RIVAL_LIMIT else None
        if law == "lost_counts":
            gaps = [np.ptp(r.t[max(0, i - 1):i + 1]) + r.time_step for r in case.train
                    for i in [int(np.searchsorted(r.t, truth["at_s"]))] if 0 < i < r.n]
            if abs(effect.get("at_s", np.inf) - truth["at_s"]) > max(gaps, default=0.0) and left_over() >= RIVAL_LIMIT:
                return None
        if law == "form_bump":
            off = (effect.get("centre_rad", np.inf) - truth["centre_rad"] + np.pi) % (2 * np.pi) - np.pi
            if not abs(off) < truth["width_rad"] / 2:
                return None
        return "right"
    listed = any(a["name"] == truth["name"] or split_name(a["name"])[0] == own_law and same_by_contract(a["name"], truth["name"])
                 for a in alternatives(entry))
    if {law, own_law} == {"thermal_growth", "thermal_lag"} and effect["name"].split(".")[1:] == truth["name"].split(".")[1:]:
        if left_over() < RIVAL_LIMIT:                  # both fit equally: growth is given
            return "rival" if listed or law == "thermal_growth" else "unlisted"
    if left_over() < RIVAL_LIMIT and left_over() < 0.25 * view.snr(truth) ** 2:
        return "rival" if listed else "unlisted"
    return "hedged" if listed and said == "not_separable" else None


def wave_sign(effect, values):
    """Flip a wave of negative amplitude: the same wave half a turn on."""
    for key in ("um", "um_per_m"):
        if "phase_rad" in values and key in values and values[key][0] is not None and values[key][0] < 0:
            v, low, high = values[key]
            values[key] = (-v, None if high is None else -high, None if low is None else -low)
            values["phase_rad"] = tuple(None if p is None else p + np.pi for p in values["phase_rad"])
    return values


def interval_hits(entry, truth):
    """[(parameter, holds)] for the intervals of a rightly named effect."""
    law, _ = split_name(truth["name"])
    if law in MAP_LAWS:
        return []
    values = read_parameters(entry)
    out = []
    if law in SENSOR_LAWS:
        sign = same_sensor(entry, truth)
        if sign == 0:
            return []
        curved = truth.get("um_per_K2") or values.get("um_per_K2", (0,))[0]
        if curved and not truth.get("minus") and entry.get("reference_degC", 20.0) != truth.get("reference_degC", 20.0):
            return []
        if sign < 0:
            if curved:
                return []
            values = {k: (v if k == "tau_s" else (-v[0], None if v[2] is None else -v[2], None if v[1] is None else -v[1]))
                      for k, v in values.items() if v[0] is not None}
    if "phase_rad" in truth and law != "probe_lobing" or law == "probe_lobing":
        values = wave_sign(entry, values)
        truth = dict(truth)
        size = next(k for k in LINEAR[law])
        if truth[size] < 0:
            truth[size], truth["phase_rad"] = -truth[size], truth["phase_rad"] + np.pi
    for key, (value, low, high) in values.items():
        if key not in truth and key not in LINEAR[law] or isinstance(value, list) or low is None or high is None:
            continue
        true = truth.get(key, 0.0)
        if key in ("lobes",):
            continue
        if key in ("um_per_K2", "um_per_krpm2") and not true and value == 0 and low == 0 and high == 0:
            continue
        if key in ("phase_rad", "centre_rad"):
            turn = (true - value + np.pi) % (2 * np.pi) - np.pi
            out.append((key, low - value <= turn <= high - value))
        else:
            slack = 1e-5 * abs(true)
            out.append((key, low - slack <= true <= high + slack))
    return out


def refined_index(effects, entry):
    """Which effect of the model a `refined` entry corrects; None if that is open."""
    same = [i for i, e in enumerate(effects) if e["name"] == entry.get("name")]
    for key in ("sensor", "minus", "period_mm", "period_um", "lobes"):
        if entry.get(key) is not None:
            same = [i for i in same if effects[i].get(key) == entry[key]]
    if len(same) > 1:                              # told apart by the value before
        for key, p in (entry.get("parameters") or {}).items():
            before = p.get("before") if isinstance(p, dict) else None
            if isinstance(before, (int, float)):
                same = [i for i in same if isinstance(effects[i].get(key, 0.0), (int, float))
                        and abs(effects[i].get(key, 0.0) - before) <= 1e-3 * abs(before)]
    return same[0] if len(same) == 1 else None


def refined_hits(case, verdict):
    """[(name.parameter, holds)] of the corrections to the known model."""
    out = []
    for entry in verdict.get("refined") or []:
        at = refined_index(case.model, entry)
        if at is None:
            continue
        true = case.known[at]
        for key, p in (entry.get("parameters") or {}).items():
            if isinstance(p, dict) and key in LINEAR[split_name(true["name"])[0]] and isinstance(true.get(key), float) \
                    and isinstance(p.get("low"), (int, float)) and isinstance(p.get("high"), (int, float)):
                out.append((f"{entry['name']}.{key}", p["low"] <= true[key] <= p["high"]))
    return out


def impossible_values(verdict):
    """Values outside what a machine can have."""
    out = []
    for entry in verdict.get("effects") or []:
        law, _ = split_name(entry.get("name", ""))
        values = read_parameters(entry)
        for key, (value, _, _) in values.items():
            bound = BOUNDS.get((law, key)) or BOUNDS.get(("*", key))
            if bound and isinstance(value, (int, float)) and not bound[0] <= value <= bound[1]:
                out.append(f"{entry['name']} {key} = {value}")
        if law == "subdivision" and values.get("um") and values.get("period_um"):
            if abs(values["um"][0] or 0) > values["period_um"][0] / 4:
                out.append(f"{entry['name']} um = {values['um'][0]} above a quarter of its period")
    return out


def gap_closed(case, verdict):
    """Share of the hold-out's missing error that the new model explains, noise-free.

    None if the old model's error is below half the noise there.
    """
    runs = [r for r in case.holdout]
    if not runs:
        return None
    stack = Stack(runs)
    q = basis(stack.setup(case.known))
    truth = stack.vector(lambda run: total(case.known + case.hidden, run))
    if case.extra is not None:
        truth = truth + stack.vector(lambda run: {r: case.extra(run, r) for r in run.responses})
    before = without(q, truth - stack.vector(lambda run: total(case.model, run)))
    if np.linalg.norm(before) < 0.5 * np.sqrt(stack.n):
        return None
    model = [dict(e) for e in case.model]
    for entry in verdict.get("refined") or []:
        at = refined_index(case.model, entry)
        for key, p in (entry.get("parameters") or {}).items() if at is not None else ():
            if isinstance(p, dict) and p.get("value") is not None and key in model[at]:
                if isinstance(model[at][key], list) == isinstance(p["value"], list):
                    model[at][key] = p["value"]
    added = [entry_effect(e) for e in verdict.get("effects") or []]
    added = [e for e in added if complete(e)]
    after = without(q, truth - stack.vector(lambda run: total(model + added, run)))
    return 1 - float(np.linalg.norm(after) / np.linalg.norm(before))


def suspected(verdict, run_name):
    """Suspicions that name a record."""
    return [s for s in verdict.get("suspicions") or [] if run_name in str(s.get("record", "")) + " " + str(s.get("text", ""))]


def describes_part(case, entry):
    """Whether a name describes a part of a nameless error."""
    if entry["name"] not in case.parts:
        return False
    values = read_parameters(entry)
    return all(abs((values.get(key) or (np.inf,))[0] - true) < 0.03 * true for key, true in case.parts[entry["name"]].items())


def judge(case, verdict):
    """Outcome of one case: right, wrong, silent or open, with the reasons."""
    out = {"class": case.kind, "seed": case.seed, "outcome": "", "why": [], "hidden": len(case.hidden), "found": 0,
           "detectable": sum(s >= DETECTABLE for s in case.snr), "found_detectable": 0, "false_names": 0,
           "required": sum(s >= SMALL for s in case.snr), "found_required": 0, "hedged": 0,
           "intervals": [], "refined": refined_hits(case, verdict), "closed": None,
           "impossible": impossible_values(verdict), "suspicions": len(verdict.get("suspicions") or [])}
    entries = [e for e in verdict.get("effects") or [] if e.get("name")]
    said = verdict.get("verdict")
    view = Visibility(case.train, case.known, case.hidden)
    left = list(range(len(entries)))
    turned = any(r.setup.get("turn_urad") for r in case.train)
    # Beside rotation the two squarenesses of a pair are one; with the other one, rotation has another value.
    true_names = {e["name"] for e in case.known + case.hidden}
    other_squareness = any(e["name"].startswith("squareness") and e["name"] not in true_names for e in entries)
    shared = any(r.zero and sum(r.zero == o.zero for o in case.train) > 1 for r in case.train)
    for i in np.argsort(case.snr)[::-1] if case.snr else []:
        truth, grade = case.hidden[i], None
        inflation = view.sensor_inflation(truth)
        grades = {k: compare(case, view, entries[k], truth, inflation, said) for k in left}
        for wish in ("right", "sensor", "rival", "unlisted", "hedged"):
            best = [k for k in left if grades[k] == wish]
            if best:
                grade = wish
                left.remove(best[0])
                break
        name = f"{truth['name']} ({case.snr[i]:.0f} sigma)"
        if grade is None:
            if case.snr[i] >= SMALL:
                out["why"].append(f"missed {name}")
            continue
        if grade == "hedged":
            out["hedged"] += 1
            out["why"].append(f"{name} listed behind {entries[best[0]]['name']}, which the data rules out")
            continue
        if grade == "unlisted":
            out["why"].append(f"{entries[best[0]]['name']} named for {name}, which fits as well and is not listed")
            out["false_names"] += 1
            continue
        out["found"] += 1
        out["found_detectable"] += case.snr[i] >= DETECTABLE
        out["found_required"] += case.snr[i] >= SMALL
        if grade == "right" and not (truth["name"].startswith("rotation") and other_squareness):
            hits = interval_hits(entries[best[0]], truth)
            out["intervals"] += [ok for _, ok in hits]
            out["why"] += [f"interval of {truth['name']} {key} misses" for key, ok in hits if not ok]
    parts = 0
    for k in left:
        law, _ = split_name(entries[k]["name"])
        if turned and law == "rotation" or shared and law == "offset":
            continue
        if case.extra is not None and not out["impossible"] and describes_part(case, entries[k]):
            parts += 1
            continue
        out["false_names"] += 1
        out["why"].append(f"false name {entries[k]['name']}")
    out["why"] += [f"impossible {text}" for text in out["impossible"]]
    out["why"] += [f"refined {key} misses" for key, ok in out["refined"] if not ok]
    if case.kind in ("hidden", "many"):
        out["closed"] = gap_closed(case, verdict)
        complete_ = out["found_detectable"] == out["detectable"]
        out["outcome"] = ("wrong" if out["false_names"] else "right" if complete_
                          else "hedged" if out["hedged"] else "silent")
        if said == "not_separable" and not any(case.rivals):
            out["why"].append("not_separable, although the data tells the names apart")
    elif case.kind == "nothing":
        loud = said != "nothing_missing" and not (entries and not out["false_names"] and said in ("named", "not_separable"))
        if out["suspicions"]:
            out["why"].append("suspicion: " + str((verdict["suspicions"][0] or {}).get("text", ""))[:160])
        if loud and not out["false_names"]:
            out["why"].append(f"verdict {said}")
        out["outcome"] = "wrong" if out["false_names"] else "loud" if loud or out["suspicions"] else "right"
    elif case.kind == "nameless":
        small = case.extra_snr < SMALL_SHAPE
        out["closed"] = gap_closed(case, verdict)
        if parts and out["closed"] is not None and out["closed"] < WORSE:
            out["false_names"] += parts
            out["why"].append(f"names a part, and the hold-out gets worse: gap closed {out['closed']:.2f}")
        if out["false_names"]:
            out["outcome"] = "wrong" if said == "named" else "hedged"
        elif said == "unknown_effect" or said == "nothing_missing" and small or said in ("named", "not_separable") and parts:
            out["outcome"] = "right"
        else:
            out["outcome"] = "silent"
            out["why"].append(f"verdict {said} at {case.extra_snr:.0f} sigma")
    else:
        told = bool(suspected(verdict, case.mistake["record"]))
        if not told:
            out["why"].append(f"mistake '{case.mistake['kind']}' of {case.mistake['record']} not said")
        out["said"] = told
        out["outcome"] = "wrong" if out["false_names"] else "right" if told else "silent"
    return out


def oracle(case):
    """The verdict of one who knows the truth."""
    def entry(effect):
        width = {k: 0.01 * abs(v) + 1e-6 for k, v in effect.items() if isinstance(v, float)}
        parameters = {k: {"value": v, "low": v - width[k], "high": v + width[k]} for k, v in effect.items()
                      if isinstance(v, float) and k != "reference_degC"}
        for k, v in effect.items():
            if isinstance(v, int):
                parameters[k] = {"value": v, "low": v, "high": v}
            elif isinstance(v, list) and k != "knots_mm":
                parameters[k] = {"value": v, "low": v, "high": v}
        return dict({k: effect[k] for k in ("name", "sensor", "minus", "reference_degC", "knots_mm") if k in effect},
                    parameters=parameters, alternatives=[])
    refined = []
    for before, after in zip(case.model, case.known):
        parameters = {k: {"before": before[k], "value": after[k],
                          **({} if isinstance(after[k], list) else {"low": after[k] - 1e-9, "high": after[k] + 1e-9})}
                      for k in LINEAR[split_name(after["name"])[0]] if after.get(k)}
        refined.append({"name": after["name"], "sensor": after.get("sensor"), "minus": after.get("minus"),
                        "parameters": parameters})
    verdict = {"verdict": "named" if case.hidden else "nothing_missing", "effects": [entry(e) for e in case.hidden],
               "refined": refined, "suspicions": []}
    if case.extra is not None:
        verdict["verdict"] = "unknown_effect"
    if case.mistake:
        verdict["suspicions"] = [{"record": case.mistake["record"] + ".run.toml", "what": case.mistake["what"], "text": ""}]
    return verdict


def silent_finder(case):
    """A finder that never finds anything."""
    return {"verdict": "nothing_missing", "effects": [], "refined": [], "suspicions": []}


def loud_finder(case):
    """A finder that names every law on every axis it sees and suspects every record."""
    from shop_stats import candidate_effects
    near = case.hidden[0] if case.hidden else {"name": "offset.x"}
    names = sorted({e["name"] for e in candidate_effects(case.train, near)} | {"offset.x", "warm_up.x"})
    return {"verdict": "named", "refined": [], "suspicions": [{"record": r.name, "text": ""} for r in case.train],
            "effects": [{"name": n, "parameters": {k: {"value": 1.0, "low": 0.5, "high": 1.5} for k in LINEAR[split_name(n)[0]]},
                         "alternatives": []} for n in names]}
