"""Checks of the shop judge itself: its files, its truth, its scoring."""
import copy
import json
import os
import tempfile
import tomllib

import numpy as np

import shop_cases
import shop_files
import shop_judge
from shop_laws import LINEAR, MAP_LAWS, Run, split_name, total
from shop_stats import Stack, basis, without

KINDS = {"positioning", "drift", "ballbar", "plate", "dynamics", "probing", "feed_sweep", "part"}
UNITS = {"time": {"s"}, "position": {"mm"}, "direction": {"1"}, "velocity": {"mm/s"}, "acceleration": {"mm/s2"},
         "cycle": {"1"}, "temperature": {"degC"}, "spindle_speed": {"rpm"}, "coolant": {"1"}, "load": {"N"},
         "angle": {"rad"}, "channel": {"1"}, "error": {"um"}, "force": {"N"}}
HEAD = {"file", "kind", "count_um", "radius_mm", "plane", "zero", "centre_mm", "turns", "over_mm", "columns"}


def read_record(path):
    """A record from its files, as tools/guide/reference/records.md describes them; raises on a breach."""
    with open(path, "rb") as f:
        head = tomllib.load(f)
    assert set(head) <= HEAD, f"unknown key {set(head) - HEAD}"
    assert head["kind"] in KINDS, head["kind"]
    lines = open(os.path.join(os.path.dirname(path), head["file"])).read().split("\n")
    names = lines[0].split(",")
    rows = [line.split(",") for line in lines[1:] if line]
    assert all(len(r) == len(names) for r in rows), "a short row"
    table = {n: np.array([float(r[i]) for r in rows]) for i, n in enumerate(names)}
    assert all(np.all(np.isfinite(v)) for v in table.values()), "a number is not finite"
    run = Run(os.path.basename(path), head["kind"], np.arange(len(rows)))
    for name, column in head["columns"].items():
        assert name in table, f"column {name} is not in the file"
        role, *axes = column["role"].split(".")
        assert column["unit"] in UNITS[role], f"{name}: unit {column['unit']}"
        values = table[name]
        if role == "time":
            assert np.all(np.diff(values) >= 0), "time runs backwards"
            run.t = values
        elif role in ("error", "force"):
            run.responses.append(column["role"])
            run.measured[column["role"]] = values
        elif role == "angle":
            run.angle = values
        elif role == "cycle":
            run.cycle = values
        elif role == "temperature":
            run.temps[name] = values
        elif role == "channel":
            run.channels[name] = values
        elif role == "spindle_speed":
            run.rpm = values
        elif role == "coolant":
            run.wet = values
        else:
            assert role != "direction" or set(np.unique(values)) <= {-1.0, 1.0}, "direction is not +1 or -1"
            tables = {"position": run.pos, "direction": run.dir, "velocity": run.vel,
                      "acceleration": run.acc, "load": run.load}
            tables[role][axes[0]] = values
    assert run.responses, "no response"
    assert len(rows) >= 11, f"only {len(rows)} rows"
    if head["kind"] == "ballbar":
        run.radius, run.plane, run.centre = head["radius_mm"], head["plane"], head.get("centre_mm")
    run.over, run.turns = head.get("over_mm"), head.get("turns")
    assert (run.over is not None) == (run.turns == "overtravel"), "over_mm goes with overtravel"
    return run


def check_model(path, effects):
    """The model file holds these effects with the contract's names and keys."""
    with open(path, "rb") as f:
        model = tomllib.load(f)
    read = model.get("effect", [])
    assert len(read) == len(effects)
    for effect in read:
        law, axes = split_name(effect["name"])
        assert shop_judge.complete(effect), f"{effect} lacks a key"
        assert any(effect.get(k) for k in LINEAR[law]), f"{effect} has no size"
        assert not ("minus" in effect and "reference_degC" in effect), "minus and reference_degC both given"


def check_inputs(effects, run):
    """A record logs the sensors and channels that the machine's effects read."""
    for effect in effects:
        law, axes = split_name(effect["name"])
        for sensor in (effect.get("sensor"), effect.get("minus")):
            assert sensor is None or sensor in run.temps, f"{run.name} lacks {sensor}"
        assert law != "channel" or axes[1] in run.channels, f"{run.name} lacks {axes[1]}"


def from_files(case, run, path):
    """Chi-square per row of a record: the file's numbers against the true law."""
    read = read_record(path)
    read.setup, read.noise, read.place_repeats = run.setup, run.noise, run.place_repeats
    read.tell_centre, read.logged = run.tell_centre, run.logged
    if "time" not in run.logged:
        read.t = run.t
    if read.kind == "ballbar":
        ways = np.sign(np.gradient(read.angle))
        rate = np.hypot(*[run.vel[a] for a in run.plane]) / run.radius
        for i, axis in enumerate(read.plane):
            centre = read.centre[i] if read.centre else run.centre[i]
            circle = centre + read.radius * (np.cos(read.angle) if i == 0 else np.sin(read.angle))
            if axis in read.pos:
                assert np.allclose(circle, read.pos[axis], atol=0.001) or not run.tell_centre
            read.pos.setdefault(axis, circle)
            along = -np.sin(read.angle) if i == 0 else np.cos(read.angle)
            read.vel[axis] = along * ways * rate * read.radius
            read.dir[axis] = np.sign(read.vel[axis])
    if read.turns is None and run.over:
        read.over = run.over
    if not read.dir and read.vel:
        read.dir = {a: np.sign(v) for a, v in read.vel.items()}
    stack = Stack([read])
    target = stack.vector(lambda r: {x: read.measured[x] - total(case.known + case.hidden, read)[x] for x in read.responses})
    if case.extra is not None:
        target = target - Stack([run]).vector(lambda r: {x: case.extra(run, x) for x in run.responses})
    left = without(basis(stack.setup(case.known)), target)
    return float(left @ left) / stack.n


def perturbed(cases):
    """[(what was done to the true verdict, cases, of which scored as expected)]."""
    def tally(text, wanted, change, expect):
        done = good = 0
        for case in cases:
            if wanted(case):
                verdict = change(copy.deepcopy(shop_judge.oracle(case)), case)
                if verdict is not None:
                    done += 1
                    good += bool(expect(shop_judge.judge(case, verdict)))
        return text, done, good

    def other_wave(verdict, case):
        found = False
        for entry in verdict["effects"]:
            p = entry["parameters"]
            size = next((k for k in ("um", "um_per_m") if k in p), None)
            if size and "phase_rad" in p:
                found = True
                a = p[size]
                p[size] = {"value": -a["value"], "low": -a["high"], "high": -a["low"]}
                p["phase_rad"] = {k: v + 5 * np.pi for k, v in p["phase_rad"].items()}
        return verdict if found else None

    def other_pair(verdict, case):
        found = False
        for entry in verdict["effects"]:
            key = "ppm_per_K" if "ppm_per_K" in entry["parameters"] else "um_per_K"
            if entry.get("minus") and not entry["parameters"].get("um_per_K2", {}).get("value"):
                found = True
                entry["sensor"], entry["minus"] = entry["minus"], entry["sensor"]
                a = entry["parameters"][key]
                entry["parameters"][key] = {"value": -a["value"], "low": -a["high"], "high": -a["low"]}
        return verdict if found else None

    def more(verdict, case):
        verdict["verdict"] = "named"
        verdict["effects"].append({"name": "coolant.q", "parameters": {"um": {"value": 1, "low": 0, "high": 2}}})
        return verdict

    def fewer(verdict, case):
        del verdict["effects"][int(np.argmax(case.snr))]
        return verdict

    def narrow(verdict, case):
        for entry in verdict["effects"]:
            for p in entry["parameters"].values():
                if not isinstance(p["value"], list):
                    p["low"] = p["high"] = p["value"] + 0.02 * abs(p["value"]) + 1e-3
        return verdict

    def accuse(verdict, case):
        others = [r.name for r in case.train if not case.mistake or r.name != case.mistake["record"]]
        verdict["suspicions"] = [{"record": others[0], "what": "sign", "text": ""}]
        return verdict
    hidden = lambda c: c.kind in ("hidden", "many")
    seen = lambda c: hidden(c) and max(c.snr) >= 5
    return [
        tally("waves turned by half a turn and over are right, with their intervals", hidden, other_wave,
              lambda r: r["outcome"] == "right" and all(r["intervals"])),
        tally("a pair of sensors exchanged, with the other sign, is right", hidden, other_pair,
              lambda r: r["outcome"] == "right" and all(r["intervals"])),
        tally("one name too many is wrong", lambda c: c.kind != "mistakes", more, lambda r: r["outcome"] == "wrong"),
        tally("the strongest effect missing is silent", seen, fewer, lambda r: r["outcome"] == "silent"),
        tally("intervals beside the truth miss", hidden, narrow,
              lambda r: not r["intervals"] or np.mean(r["intervals"]) < 0.5),
        tally("a clean record accused is loud", lambda c: c.kind == "nothing", accuse, lambda r: r["outcome"] == "loud"),
        tally("another record accused is silent", lambda c: c.kind == "mistakes", accuse, lambda r: r["outcome"] == "silent"),
    ]


def share(results, label, outcome="right"):
    rows = [r for r in results if r["class"] == label]
    return sum(r["outcome"] == outcome for r in rows) / max(1, len(rows))


def check(options, run_all, figures):
    """Print each self-check with its figure; 0 if all hold."""
    count = options.count
    failed = []

    def say(text, good):
        print(("holds   " if good else "FAILS   ") + text)
        if not good:
            failed.append(text)

    fits, breaches, cases, sizes = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for kind in shop_cases.CLASSES:
            for seed in range(options.first, options.first + count):
                case = shop_cases.make_case(kind, seed)
                cases.append(case)
                place = os.path.join(folder, f"{kind}-{seed}")
                train, later, model = shop_files.write_case(case, place)
                for run, path in zip(case.train + case.holdout, train + later):
                    try:
                        read = read_record(path)
                        sizes.append(read.n)
                        wrong_record = case.mistake and run.name == case.mistake["record"]
                        if not wrong_record:
                            fits.append((from_files(case, run, path), f"{kind} {seed} {run.name}"))
                    except AssertionError as error:
                        breaches.append(f"{kind} {seed} {run.name}: {error}")
                try:
                    check_model(model, case.model)
                    for run in case.train + case.holdout:
                        check_inputs(case.known + case.hidden, run)
                except AssertionError as error:
                    breaches.append(f"{kind} {seed} model: {error}")
                again = shop_cases.make_case(kind, seed)
                second = os.path.join(folder, "again")
                shop_files.write_case(again, second)
                for path in train + later + [model]:
                    if open(path).read() != open(os.path.join(second, os.path.basename(path))).read():
                        breaches.append(f"{kind} {seed}: not the same twice")
                        break
    say(f"{len(sizes)} records of {min(sizes)} to {max(sizes)} rows obey the format, the same for the same seed", not breaches)
    for line in breaches[:5]:
        print("          ", line)
    values = np.array([f for f, _ in fits])
    high = [f"{name} {value:.1f}" for value, name in fits if value > 4]
    say(f"the files carry the truth: squared misfit per row in sigma, median {np.median(values):.2f}, "
        f"99th percentile {np.percentile(values, 99):.2f}", np.median(values) < 1.3 and np.percentile(values, 99) < 4)
    for line in high[:8]:
        print("           high:", line)
    off = [a[k] / b[k] - 1 for c in cases for b, a in zip(c.known, c.model) for k in LINEAR[split_name(b["name"])[0]]
           if isinstance(b.get(k), float) and b[k]]
    say(f"the model's amplitudes are off by {100 * np.std(off):.1f} % (contract: 10 %)", 0.08 < np.std(off) < 0.12)
    snr = np.array([s for c in cases for s in c.snr])
    say(f"hidden effects: {len(snr)}, of which {np.mean(snr >= 5) * 100:.0f} % stand 5 sigma out, "
        f"quartiles {np.percentile(snr, 25):.0f}, {np.median(snr):.0f}, {np.percentile(snr, 75):.0f} sigma", np.mean(snr >= 5) > 0.7)

    for text, done, good in perturbed(cases):
        say(f"{text}: {good} of {done}", good == done and done > 0)

    work = [(kind, seed) for kind in shop_cases.CLASSES for seed in range(options.first, options.first + count)]
    options.keep = None
    tables = {}
    for finder in ("oracle", "silent_finder", "loud_finder"):
        options.finder = finder
        tables[finder] = results = run_all(work, options)
        if finder == "oracle":
            bad = [f"{r['class']} {r['seed']}: {r['outcome']} {r['why']}" for r in results if r["outcome"] != "right"]
            table = figures(results)
            held = sum(f["interval_holds"] for f in table.values()), sum(f["intervals"] for f in table.values())
            closed = [r["closed"] for r in results if r["class"] in ("hidden", "many") and r.get("closed") is not None]
            say(f"who knows the truth scores {100 * (1 - len(bad) / len(results)):.1f} %, intervals {held[0]} of {held[1]}, "
                f"gap closed at least {min(closed):.3f}",
                not bad and held[0] == held[1])
            for line in bad[:8]:
                print("          ", line)
        elif finder == "silent_finder":
            say(f"who never finds anything: hidden right {100 * share(results, 'hidden'):.0f} %, many "
                f"{100 * share(results, 'many'):.0f} %, mistakes said {100 * share(results, 'mistakes'):.0f} %, "
                f"nothing quiet {100 * share(results, 'nothing'):.0f} %",
                share(results, "hidden") < 0.2 and share(results, "mistakes") == 0 and share(results, "nothing") == 1)
        else:
            say(f"who names everything: hidden wrong {100 * share(results, 'hidden', 'wrong'):.0f} %, nothing quiet "
                f"{100 * share(results, 'nothing'):.0f} %, nameless named {100 * share(results, 'nameless', 'wrong'):.0f} %",
                share(results, "hidden", "wrong") > 0.9 and share(results, "nothing") < 0.05)
    options.finder = None
    print("all self-checks hold" if not failed else f"{len(failed)} self-checks fail")
    return 1 if failed else 0
