"""Findings that only the whole shop shows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from math import comb
from typing import Any

import numpy as np
import pandas as pd

#: A set of machines, or of months of machines.
Members = set[Any]

#: Smallest number of machines that can share a cause.
_FEWEST = 3
#: Probability that chance alone makes a cause common, for all causes of a shop.
_LEVEL = 0.01
#: A figure has left its history if it moved by this many times the usual change of such figures from month to month.
_TIMES = 6.0


Values = dict[tuple[str, str, str], float]


def _of_machine(values: Values, effect: str, seen: Mapping[str, set[str]], machine: str) -> list[float]:
    return [values[effect, machine, month] for month in seen[machine] if (effect, machine, month) in values]


def _of_unit(values: Values, effect: str, unit: tuple[str, str]) -> list[float]:
    return [values[effect, unit[0], unit[1]]]


def _tail(both: int, having: int, drawn: int, of: int) -> float:
    """Probability that `drawn` of `of` hold at least `both` of the `having` ones."""
    ways = sum(comb(having, k) * comb(of - having, drawn - k) for k in range(both, min(having, drawn) + 1))
    return ways / comb(of, drawn)


def shared(
    effects: pd.DataFrame, months: pd.DataFrame, attributes: Mapping[str, Mapping[str, str]]
) -> pd.DataFrame:
    """Causes that machines share, each with what they have in common.

    An effect that a machine shows in at least half of its months is permanent, and is compared with what the machines have in
    common (a batch of scales). One that comes and goes is compared with the months (a heat wave), with months of machines that have
    something in common, and with the names in records' notes (`fixture=F3`). After a cause is removed, the rest is tested again.
    Probabilities are hypergeometric, each multiplied by the number of comparisons.
    """
    judged = months[months["verdict"].notna()]
    seen: dict[str, set[str]] = defaultdict(set)
    for machine, month in zip(judged["machine"], judged["month"]):
        seen[machine].add(month)
    units = {(machine, month) for machine, all_months in seen.items() for month in all_months}
    notes = {(row.machine, row.month): set(row.noted) for row in judged.itertuples()}
    had: dict[str, set[tuple[str, str]]] = defaultdict(set)
    values: Values = {}
    for row in effects.itertuples():
        had[row.effect].add((row.machine, row.month))
        values[row.effect, row.machine, row.month] = row.value
    # Each group: what it has in common, its members, and all that could be in it.
    of_machines: dict[str, Members] = defaultdict(set)
    for machine in seen:
        for key, value in attributes.get(machine, {}).items():
            of_machines[f"{key}={value}"].add(machine)
    rows: list[list[Any]] = []
    comparisons = max(1, len(had) * (len(of_machines) + len({m for _, m in units}) * (1 + len(of_machines))))
    for effect, where in sorted(had.items()):
        count: dict[str, int] = defaultdict(int)
        for machine, _ in where:
            count[machine] += 1
        lasting = {machine for machine, n in count.items() if 2 * n >= len(seen[machine]) and (n > 1 or len(seen[machine]) == 1)}
        passing = {unit for unit in where if unit[0] not in lasting}
        groups = [(name, members, set(seen)) for name, members in of_machines.items()]
        of = partial(_of_machine, values, effect, seen)
        rows += _explained(effect, lasting, groups, comparisons, of)
        free = {unit for unit in units if unit[0] not in lasting}
        by_note: dict[str, Members] = defaultdict(set)
        for unit in free:
            for note in notes.get(unit, ()):
                by_note[note].add(unit)
        pairs = [(name, members, free) for name, members in by_note.items()]
        for month in sorted({m for _, m in free}):
            members: Members = {unit for unit in free if unit[1] == month}
            pairs.append((f"month={month}", members, free))
            for name, machines in of_machines.items():
                pairs.append((f"month={month}, {name}", {u for u in members if u[0] in machines}, free))
        rows += _explained(effect, passing, pairs, comparisons + len(by_note), partial(_of_unit, values, effect))
    frame = pd.DataFrame(rows, columns=["effect", "common", "machines", "of", "value", "spread", "p_value"])
    return frame.sort_values("p_value").reset_index(drop=True)


def standing_out(set_ups: pd.DataFrame) -> pd.DataFrame:
    """The set-ups that differ from the others of this shop.

    A gauge's zero gives no information for one machine alone. Among many it shows that one fixture is at another place."""
    by_kind = set_ups.groupby("effect")["value"]
    off = (set_ups["value"] - by_kind.transform("median")).abs()
    usual = off.groupby(set_ups["effect"]).transform("median") / 0.6745
    return set_ups[off > _TIMES * usual]


def _explained(
    effect: str,
    holders: Members,
    groups: list[tuple[str, Members, Members]],
    comparisons: int,
    valued: Callable[[Any], list[float]],
) -> list[list[Any]]:
    """The groups that have more of the holders than chance explains, the most certain first.

    Each takes its holders out of the comparison for the next."""
    rows, left = [], set(holders)
    while len(left) >= _FEWEST:
        best = None
        for name, members, of in groups:
            both = left & members
            # A group does not share a cause that most of its members do not show.
            if len(both) < _FEWEST or 2 * len(both) < len(members):
                continue
            p = _tail(len(both), len(left), len(members), len(of))
            if best is None or (p, -len(both)) < (best[0], -len(best[2])):
                best = (p, name, both, members)
        if best is None or best[0] * comparisons > _LEVEL:
            break
        p, name, both, members = best
        numbers = np.array([v for unit in both for v in valued(unit) if pd.notna(v)], dtype=float)
        value = float(np.median(numbers)) if numbers.size else None
        spread = float(1.4826 * np.median(np.abs(numbers - value))) if numbers.size else None
        machines = sorted({unit if isinstance(unit, str) else unit[0] for unit in both})
        rows.append([effect, name, machines, len(members), value, spread, min(1.0, p * comparisons)])
        left -= both
    return rows


def drifting(figures: pd.DataFrame) -> pd.DataFrame:
    """Figures that left their own history.

    The last value is compared with the median of those before. The unit is the change of such figures from one record to the next
    over the whole shop (robust standard deviation)."""
    columns = ["machine", "figure", "before", "now", "times", "date"]
    rows = []
    ordered = figures.dropna(subset=["value"]).sort_values(["machine", "figure", "date"])
    for figure, of_all in ordered.groupby("figure"):
        moved, last = [], []
        for machine, own in of_all.groupby("machine"):
            values = own["value"].to_numpy(dtype=float)
            if len(values) > 1:
                moved.extend(np.diff(values))
                last.append((machine, float(np.median(values[:-1])), float(values[-1]), own["date"].iloc[-1]))
        if len(moved) < 10:
            continue
        sd = 1.4826 * float(np.median(np.abs(np.array(moved) - np.median(moved))))
        for machine, before, now, date in last:
            if sd > 0.0 and abs(now - before) > _TIMES * sd:
                rows.append([machine, figure, before, now, (now - before) / sd, date])
    frame = pd.DataFrame(rows, columns=columns)
    return frame.sort_values("times", key=abs, ascending=False).reset_index(drop=True)
