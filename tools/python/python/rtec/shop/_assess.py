"""Judges every month of every machine, one task each."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import combinations, groupby
from typing import Any

import numpy as np
import pandas as pd
from dask.distributed import Client, as_completed

import rtec
from rtec.shop._across import drifting, shared, standing_out
from rtec.shop._store import Run, Shop

#: `fixture=F3` in a record's note: a property that the run shares with others.
_NOTED = re.compile(r"(\w+)=([\w.-]+)")

#: With fewer distinct values, two runs may be equal by chance.
_VALUES = 8


@dataclass(frozen=True)
class Assessment:
    """The results of an assessment, as DataFrames."""

    #: A row for each machine: ``verdict`` of its last month, its own causes, causes it shares, ``days_left`` of its model.
    machines: pd.DataFrame
    #: A row for each month of each machine: ``verdict``, ``gap_before_um`` and ``gap_after_um``, ``error``, ``seconds`` of one core.
    months: pd.DataFrame
    #: A row for each effect that a model lacks: ``machine``, ``month``, ``effect``, ``value``, ``p_value``. `unexplained error.x` is one
    #: too, and so is `set_up zero_um`: a set-up that differs from the others of this shop.
    effects: pd.DataFrame
    #: A row for each figure of each record: ``machine``, ``month``, ``run``, ``figure``, ``value``; or its ``error``.
    figures: pd.DataFrame
    #: Causes that many machines share: ``effect``, what they have in common, ``machines``, ``value``, ``p_value``.
    shared: pd.DataFrame
    #: Figures that left their own history: ``machine``, ``figure``, ``before``, ``now``, ``times``.
    drifting: pd.DataFrame
    #: Models whose validity ends soon: ``machine``, ``days_left``.
    expiring: pd.DataFrame
    #: Records that cannot be read or evaluated, that have no date for a history, or that came twice with changes: ``machine``, ``month``, ``run``, ``error``.
    unreadable: pd.DataFrame


def judge(shop: Shop, machine: str, month: str, keys: list[str], level: float) -> dict[str, Any]:
    """Judges one month of one machine. A faulty record or model becomes a row and raises nothing."""
    start = time.process_time()
    records, figures, noted, logs = [], [], set(), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rtec.InputWarning)
        read: dict[str, Any] = {}
        for key in keys:
            try:
                read[key] = shop.get(key)
            except Exception as error:  # whatever a store holds: one row, not the end
                read[key] = error
        twice = _came_twice({key: run for key, run in read.items() if isinstance(run, rtec.Record)})
        for key, run in read.items():
            row: dict[str, Any] = {"machine": machine, "month": month, "run": key.rsplit("/", 1)[1]}
            try:
                if isinstance(run, Exception):
                    raise run
                if key in twice:
                    raise ValueError(twice[key])
                if not run.responses:  # a log: it is kept, but not judged
                    logs += 1
                    continue
                found = rtec.history(run, machine).document
            except Exception as error:  # whatever a store holds: one row, not the end
                figures.append(row | {"error": f"{type(error).__name__}: {error}"})
                continue
            records.append(run)
            noted |= set(_NOTED.findall(run.note or ""))
            for left in found["left_out"]:
                figures.append(row | {"error": left["why"]})
            for figure in found["figures"]:
                point = figure["points"][-1]
                figures.append(row | {"figure": figure["name"], "date": point["date"], "value": point["value"]})
        said: dict[str, Any] = {"machine": machine, "month": month, "runs": len(keys), "verdict": None, "error": None}
        effects: list[dict[str, Any]] = []
        set_ups: list[dict[str, Any]] = []
        try:
            if not records and logs == len(keys):
                return {"month": said | {"seconds": time.process_time() - start, "noted": []}, "effects": [], "set_ups": [], "figures": []}
            if not records:
                raise ValueError("no record that can be read")
            verdict = rtec.reconcile(records, shop.model(machine), level=level)
            said["verdict"] = verdict.verdict
            gaps = verdict.document["gap"]
            gap = gaps if isinstance(gaps, dict) else gaps[0]
            said |= {"gap_before_um": gap["train"]["before"], "gap_after_um": gap["train"]["after"]}
            for effect in verdict.effects:
                name, p = next(iter(effect["parameters"].items()))
                value = p["value"] if isinstance(p["value"], float) else None
                of = {"effect": effect["name"], "parameter": name, "value": value, "p_value": effect["p_value"]}
                effects.append({"machine": machine, "month": month, **of})
            # Machines may also share a shape without a name.
            for response in sorted({shape["response"] for shape in verdict.document["unexplained"]}):
                effects.append({"machine": machine, "month": month, "effect": f"unexplained {response}"})
            for terms in verdict.document["set_up"].values():
                for name, value in terms.items():
                    for number in value if isinstance(value, list) else [value]:
                        set_ups.append({"machine": machine, "month": month, "effect": f"set_up {name}", "value": number})
        except Exception as error:
            said["error"] = f"{type(error).__name__}: {error}"
    said["seconds"] = time.process_time() - start
    said["noted"] = sorted(f"{k}={v}" for k, v in noted)
    return {"month": said, "effects": effects, "set_ups": set_ups, "figures": figures}


def _came_twice(runs: dict[str, rtec.Record]) -> dict[str, str]:
    """Runs of one name with nine rows in ten equal to the last bit: one was changed after it was sent.

    No machine repeats its errors row by row, unless they take few values."""
    said: dict[str, str] = {}
    for (one, a), (other, b) in combinations(runs.items(), 2):
        names = [place.rsplit("/", 1)[1].rsplit("-", 1)[0] for place in (one, other)]
        if names[0] != names[1] or a.responses != b.responses or len(a) != len(b):
            continue
        told = [name for name in a.responses if np.unique(a[name]).size >= _VALUES]
        same = min((int(np.sum(a[name] == b[name])) for name in told), default=0)
        if 10 * same >= 9 * len(a):
            for place, twin in ((one, other), (other, one)):
                text = f"{same} of {len(a)} rows are those of {twin.rsplit('/', 1)[1]}"
                said[place] = f"{text}: changed after it was sent? Neither is judged: take the wrong one out of the store"
    return said


def assess(
    shop: Shop | str,
    client: Client | str | None = None,
    *,
    today: str | None = None,
    soon_days: int = 60,
    level: float = 0.01,
) -> Assessment:
    """Judges every month of every machine of a store, then the shop as a whole.

    ``client``: a cluster's address (``tcp://…``) or a client of Dask; without it the work is done in this process. If a worker dies,
    another one repeats its task. ``today``: the day for which models' validity is judged.
    """
    shop = shop if isinstance(shop, Shop) else Shop(shop)
    units = [
        (machine, month, [run.key for run in runs])
        for (machine, month), runs in groupby(shop.runs(), key=lambda run: (run.machine, run.month))
    ]
    # Checked before the work, not after it.
    attributes = _attributes(shop, {unit[0] for unit in units})
    if not units:
        text = f"{shop.url}: no record; what was sent to its inbox is taken among the records by Shop.gather()"
        warnings.warn(text, rtec.InputWarning, stacklevel=2)
    if isinstance(client, str):
        try:
            own = Client(client)
        except (OSError, ValueError) as error:
            raise ConnectionError(f"{client}: {error}; expected a scheduler of Dask, as tcp://HOST:8786") from error
        with own:
            done = _spread(own, shop, units, level)
    elif client is None:
        done = [judge(shop, *unit, level) for unit in units]
    else:
        done = _spread(client, shop, units, level)
    done.sort(key=lambda unit: (unit["month"]["machine"], unit["month"]["month"]))
    return _over(shop, done, attributes, today, soon_days)


def _spread(client: Client, shop: Shop, units: list[tuple[str, str, list[str]]], level: float) -> list[dict[str, Any]]:
    futures = {client.submit(judge, shop, *unit, level, pure=False): unit for unit in units}
    done = []
    for future in as_completed(list(futures)):
        machine, month, keys = futures.pop(future)
        try:
            done.append(future.result())
        except Exception as error:  # the task killed its workers repeatedly
            why = f"{type(error).__name__}: {error}"
            row = {"machine": machine, "month": month, "runs": len(keys), "verdict": None, "error": why, "noted": []}
            done.append({"month": row, "effects": [], "set_ups": [], "figures": []})
        future.release()
    return done


def _frame(rows: list[dict[str, Any]], columns: list[str]) -> pd.DataFrame:
    frame = pd.DataFrame(rows)
    return frame.reindex(columns=[*columns, *(c for c in frame.columns if c not in columns)])


def _attributes(shop: Shop, machines: set[str]) -> dict[str, dict[str, str]]:
    attributes = shop.attributes()
    for name in sorted(set(attributes) - machines) if machines else ():
        near = get_close_matches(name, machines, 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        text = f"{shop.url}/machines.toml: [{name}] is a machine without a record{hint}"
        warnings.warn(text, rtec.InputWarning, stacklevel=3)
    return attributes


def _over(
    shop: Shop, done: list[dict[str, Any]], attributes: dict[str, dict[str, str]], today: str | None, soon_days: int
) -> Assessment:
    months = _frame(
        [unit["month"] for unit in done],
        ["machine", "month", "runs", "verdict", "gap_before_um", "gap_after_um", "error", "seconds", "noted"],
    )
    set_ups = _frame([row for unit in done for row in unit["set_ups"]], ["machine", "month", "effect", "value"])
    effects = _frame(
        [effect for unit in done for effect in unit["effects"]] + standing_out(set_ups).to_dict("records"),
        ["machine", "month", "effect", "parameter", "value", "p_value"],
    )
    rows = [row for unit in done for row in unit["figures"]]
    figures = _frame(rows, ["machine", "month", "run", "figure", "date", "value", "error"])
    bad = figures["error"].notna()
    common = shared(effects, months, attributes)
    left = drifting(figures[~bad])
    lives = []
    for machine in shop.models():
        try:
            lives.append({"machine": machine, "days_left": shop.model(machine).days_left(today)})
        except (rtec.InputError, OSError) as error:
            lives.append({"machine": machine, "days_left": None, "error": str(error)})
    life = _frame(lives, ["machine", "days_left"])
    soon = life[life["days_left"].notna() & (pd.to_numeric(life["days_left"]) <= soon_days)]
    return Assessment(
        _machines(months, effects, common, life),
        months,
        effects,
        figures[~bad].drop(columns="error"),
        common,
        left,
        soon.sort_values("days_left").reset_index(drop=True),
        figures.loc[bad, ["machine", "month", "run", "error"]].reset_index(drop=True),
    )


def _machines(
    months: pd.DataFrame, effects: pd.DataFrame, common: pd.DataFrame, life: pd.DataFrame
) -> pd.DataFrame:
    explained: dict[tuple[str, str], set[str]] = {}
    for cause in common.itertuples():
        for machine in cause.machines:
            explained.setdefault((machine, cause.effect), set()).add(cause.common)
    rows = []
    days: Mapping[str, Any] = dict(zip(life["machine"], life["days_left"]))
    by_machine = {name: group for name, group in effects.groupby("machine")}
    for machine, own in months.groupby("machine"):
        judged = own[own["verdict"].notna() | own["error"].notna()]
        last = (own if judged.empty else judged).iloc[-1]
        group = by_machine.get(machine)
        names = [] if group is None else sorted(set(group["effect"]))
        rows.append(
            {
                "machine": machine,
                "verdict": last["verdict"],
                "error": last["error"],
                "own": [name for name in names if (machine, name) not in explained],
                "shared": sorted(c for name in names for c in explained.get((machine, name), ())),
                "days_left": days.get(machine),
            }
        )
    return _frame(rows, ["machine", "verdict", "error", "own", "shared", "days_left"])
