#!/usr/bin/python3
"""Blind judge of `rtecctl reconcile`: records as a machine shop makes them.

A generator with a hidden truth and a judge of the verdict, written from
the formats of files and documents (tools/guide/reference) and from the model
of estimation (tools/guide/contributor/estimate.md) alone.

    /usr/bin/python3 tests/judges/shop.py --from 1 --count 40            all classes
    /usr/bin/python3 tests/judges/shop.py --class nameless -v            what failed, and why
    /usr/bin/python3 tests/judges/shop.py --at-least                     the fixed quick set, exit 1 below its limits
    /usr/bin/python3 tests/judges/shop.py --self                         checks of the judge itself
"""
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import argparse
import concurrent.futures
import copy
import json
import shutil
import signal as signals
import subprocess
import sys
import tempfile
import threading

import numpy as np

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import shop_cases
import shop_files
import shop_judge

QUICK_SEED, QUICK_COUNT = 1000, 20
CLASS_TEXT = {
    "hidden": "one or two effects of the dictionary are missing from the model",
    "many": "three to seven are missing, in one or several records",
    "nothing": "the model is the truth up to its 10 %: nothing may be found or suspected",
    "nameless": "real life that no effect describes: no wrong name may be given",
    "mistakes": "one record carries a person's mistake: it must be said; its clean twin must stay quiet",
}


def run_program(program, train, later, model, limit_s):
    """(exit code, verdict or None, user CPU seconds, last words on stderr)."""
    command = [program, "reconcile", *train, "--model", model]
    for record in later:
        command += ["--holdout", record]
    command += ["--json"]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        process = subprocess.Popen(command, stdout=out, stderr=err, stdin=subprocess.DEVNULL)
        timer = threading.Timer(limit_s, lambda: os.kill(process.pid, signals.SIGKILL))
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        text = err.read().decode(errors="replace").strip()
        try:
            verdict = json.loads(out.read().decode())
        except ValueError:
            verdict = None
    return process.returncode, verdict, usage.ru_utime, text[-2000:]


def clean_twin(case):
    """The mistaken case without its mistake, judged as `nothing`."""
    twin = copy.copy(case)
    twin.kind, twin.train, twin.mistake = "nothing", case.clean_train, None
    return twin


def score(case, folder, options):
    """Write one case, run the program and judge it."""
    if options.finder:                            # a finder inside --self
        verdict = getattr(shop_judge, options.finder)(case)
        result = shop_judge.judge(case, verdict)
        result["cpu_s"] = 0.0
        return result
    train, later, model = shop_files.write_case(case, folder)
    code, verdict, cpu, words = run_program(options.bin, train, later, model, options.limit)
    with open(os.path.join(folder, "verdict.json"), "w") as f:
        json.dump(verdict if verdict is not None else {"exit": code, "stderr": words}, f, indent=1)
    if verdict is None or "verdict" not in verdict:
        result = shop_judge.judge(case, {"verdict": "no answer"})
        result.update(outcome="no answer", why=[f"exit {code}: {words.splitlines()[-1] if words else 'no output'}"])
        if case.mistake and code == 2 and case.mistake["record"] in words:
            result.update(outcome="right", said=True)    # refused with the record's name: said
    else:
        try:
            result = shop_judge.judge(case, verdict)
        except Exception as error:                # a document of another shape than the contract's
            result = shop_judge.judge(case, {"verdict": "no answer"})
            result.update(outcome="no answer", why=[f"the verdict cannot be judged: {error!r}"])
    result["cpu_s"] = cpu
    return result


def one_case(kind, seed, options):
    """All results of one case; `mistakes` gives two, itself and its twin."""
    try:
        case = shop_cases.make_case(kind, seed)
    except Exception as error:                    # a defect of the generator must be seen
        return [{"class": kind, "seed": seed, "outcome": "no case", "why": [repr(error)]}]
    base = options.keep or tempfile.mkdtemp(prefix="shop-")
    results = []
    pairs = [(case, kind)] + ([(clean_twin(case), "clean twins")] if kind == "mistakes" else [])
    for each, label in pairs:
        folder = os.path.join(base, f"{label.replace(' ', '-')}-{seed}")
        result = score(each, folder, options)
        result.update({"class": label, "scenario": case.scenario, "detail": case.extra_name
                       or (case.mistake or {}).get("kind", "") if label != "clean twins" else ""})
        results.append(result)
    if not options.keep:
        shutil.rmtree(base, ignore_errors=True)
    return results


def run_all(work, options):
    """Results of [(class, seed)], in order."""
    results = []
    if options.jobs == 1:
        for kind, seed in work:
            results += one_case(kind, seed, options)
        return results
    with concurrent.futures.ProcessPoolExecutor(options.jobs) as pool:
        for batch in pool.map(one_case, [w[0] for w in work], [w[1] for w in work], [options] * len(work)):
            results += batch
    return results


# ---------------------------------------------------------------- figures

def percent(part, whole):
    """'93 ± 2 %' with the binomial standard error; '–' of nothing.

    The error is that of half a case more on each side, so that 0 of 20 is not
    said to be certain.
    """
    if not whole:
        return "–"
    smooth = (part + 0.5) / (whole + 1)
    return f"{100 * part / whole:.0f} ± {100 * np.sqrt(smooth * (1 - smooth) / whole):.0f} %"


def figures(results):
    """{class: figures} of a list of results."""
    out = {}
    for label in list(dict.fromkeys(r["class"] for r in results)):
        rows = [r for r in results if r["class"] == label]
        hits = [ok for r in rows for ok in r.get("intervals", [])]
        refined = [ok for r in rows for _, ok in r.get("refined", [])]
        gaps = [r["closed"] for r in rows if r.get("closed") is not None]
        cpu = [r.get("cpu_s", 0.0) for r in rows]
        count = lambda *names: sum(r["outcome"] in names for r in rows)
        total = lambda key: int(sum(r.get(key, 0) for r in rows))
        out[label] = {
            "cases": len(rows), "right": count("right"), "wrong": count("wrong"), "silent": count("silent"),
            "loud_or_hedged": count("loud", "hedged"), "no_answer": count("no answer", "no case"),
            "hidden": total("hidden"), "found": total("found"), "required": total("required"),
            "found_required": total("found_required"), "detectable": total("detectable"),
            "found_detectable": total("found_detectable"), "false_names": total("false_names"),
            "intervals": len(hits), "interval_holds": int(sum(hits)),
            "refined": len(refined), "refined_holds": int(sum(refined)),
            "closed_median": float(np.median(gaps)) if gaps else None,
            "closed_tenth": float(np.percentile(gaps, 10)) if gaps else None,
            "impossible": sum(len(r.get("impossible", [])) for r in rows), "suspicions": total("suspicions"),
            "said": sum(bool(r.get("said")) for r in rows),
            "cpu_median_s": float(np.median(cpu)), "cpu_worst_s": float(np.max(cpu))}
    return out


def print_table(table):
    print(f"{'class':<12} {'cases':>5}  {'right':>11} {'wrong':>11} {'silent':>11}"
          f" {'loud/hedged':>11} {'no answer':>9}"
          f" {'false names':>11} {'suspicions':>10} {'impossible':>10} {'cpu median':>10} {'worst':>7}")
    for label, f in table.items():
        n = f["cases"]
        shares = " ".join(f"{percent(f[k], n):>11}" for k in ("right", "wrong", "silent", "loud_or_hedged"))
        print(f"{label:<12} {n:>5}  {shares} {f['no_answer']:>9} {f['false_names']:>11} {f['suspicions']:>10}"
              f" {f['impossible']:>10}"
              f" {f['cpu_median_s']:>8.2f} s {f['cpu_worst_s']:>5.1f} s")
    print()
    print(f"{'class':<12} {'effects found':>16} {'from 2 sigma':>18} {'from 5 sigma':>18}"
          f" {'intervals hold':>18} {'refined hold':>18} {'gap closed: median':>18} {'10th':>6}")
    for label, f in table.items():
        pair = lambda a, b: f"{percent(f[a], f[b])} of {f[b]}"
        gap = ["–" if f[k] is None else f"{f[k]:.2f}" for k in ("closed_median", "closed_tenth")]
        print(f"{label:<12} {pair('found', 'hidden'):>16} {pair('found_required', 'required'):>18}"
              f" {pair('found_detectable', 'detectable'):>18} {pair('interval_holds', 'intervals'):>18}"
              f" {pair('refined_holds', 'refined'):>18} {gap[0]:>18} {gap[1]:>6}")


def limits_missed(table):
    """Which limits of the quick set are missed."""
    zero = {"cases": 0, "right": 0, "wrong": 0, "intervals": 0, "interval_holds": 0, "said": 0}
    get = lambda label: table.get(label, zero)
    share = lambda part, whole: part / whole if whole else 0.0
    hidden = {k: get("hidden")[k] + get("many")[k] for k in zero}
    quiet = {k: get("nothing")[k] + get("clean twins")[k] for k in zero}
    checks = [
        ("hidden right", share(get("hidden")["right"], get("hidden")["cases"]), 0.92, 1),
        ("hidden wrong", share(get("hidden")["wrong"], get("hidden")["cases"]), 0, 0.02),
        ("nothing quiet", share(quiet["right"], quiet["cases"]), 0.98, 1),
        ("nameless named", share(get("nameless")["wrong"], get("nameless")["cases"]), 0, 0.05),
        ("mistakes said", share(get("mistakes")["said"], get("mistakes")["cases"]), 0.95, 1),
        ("intervals", share(hidden["interval_holds"], hidden["intervals"]), 0.90, 0.99),
    ]
    return [f"{name}: {100 * value:.1f} %, allowed {100 * low:.0f} to {100 * high:.0f} %"
            for name, value, low, high in checks if not low <= value <= high]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--bin", default="target/release/rtecctl", help="the program")
    parser.add_argument("--class", dest="classes", action="append", choices=shop_cases.CLASSES, help="only this class")
    parser.add_argument("--from", dest="first", type=int, default=1, metavar="SEED", help="first seed")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="cases per class")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="cases at a time")
    parser.add_argument("--limit", type=float, default=300.0, metavar="S", help="seconds before a run is stopped")
    parser.add_argument("--keep", metavar="DIR", help="keep cases, truth.json and verdict.json here")
    parser.add_argument("--json", action="store_true", help="figures and results as one document")
    parser.add_argument("--list", action="store_true", help="print the classes and what they hold")
    parser.add_argument("--self", dest="check", action="store_true", help="check the judge itself")
    parser.add_argument("--at-least", action="store_true", help="fixed quick set; exit 1 below its limits")
    parser.add_argument("-v", "--verbose", action="store_true", help="one line for each case that failed")
    options = parser.parse_args()
    options.finder = None
    if options.list:
        import shop_mistakes
        import shop_nameless
        for kind, text in CLASS_TEXT.items():
            print(f"{kind:<10} {text}")
        print("scenarios ", ", ".join(sorted(set(sum(shop_cases.SCENARIOS.values(), [])))))
        print("nameless  ", ", ".join(k.__name__ for k in shop_nameless.KINDS))
        print("mistakes  ", ", ".join(k.__name__ for k in shop_mistakes.BY_CONTRADICTION + shop_mistakes.BY_ITSELF))
        return 0
    if options.check:
        import shop_self
        return shop_self.check(options, run_all, figures)
    if options.at_least:
        options.first, options.count, options.classes = QUICK_SEED, QUICK_COUNT, None
    if not os.path.exists(options.bin):
        print(f"no program at {options.bin}; build it or give --bin PATH", file=sys.stderr)
        return 2
    work = [(kind, seed) for kind in options.classes or shop_cases.CLASSES
            for seed in range(options.first, options.first + options.count)]
    results = run_all(work, options)
    table = figures(results)
    missed = limits_missed(table) if options.at_least else []
    if options.json:
        print(json.dumps({"figures": table, "results": results, "limits_missed": missed}, default=float))
    else:
        if options.verbose:
            for r in results:
                if r["outcome"] != "right" or r["why"]:
                    print(f"{r['class']} {r['seed']} {r.get('scenario', '')} {r.get('detail', '')}: {r['outcome']}; "
                          + "; ".join(r["why"]))
            print()
        print_table(table)
        for line in missed:
            print("below the limit:", line)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
