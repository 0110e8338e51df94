"""Results that contain a machine model or records."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from rtec import _documents as doc
from rtec._machine import Machine
from rtec._record import Record
from rtec._regression import Regression, regression
from rtec._results import Drawn, Result, short


def _intervals(effect: doc.Effect) -> str:
    """The parameters of an effect with their 95 % intervals."""
    stated = [(name, p) for name, p in effect["parameters"].items() if "low" in p]
    each = [(name, short(p["value"]), short(p["low"]), short(p["high"])) for name, p in stated]
    return ", ".join(f"{name} = {value} ({low} to {high})" for name, value, low, high in each)


def _arrays(records: list[Record], base: Machine | None, machine: Machine, of_verdict: bool) -> Regression:
    inner = None if base is None else base._inner
    return regression([run._inner for run in records], inner, machine._inner, of_verdict)


@dataclass(frozen=True, repr=False)
class Fit(Drawn[doc.FitDocument]):
    """A fit: the model, and how it was found (the document)."""

    machine: Machine = field(kw_only=True)
    _records: list[Record] = field(default_factory=list, repr=False, compare=False)
    _base: Machine | None = field(default=None, repr=False, compare=False)

    @cached_property
    def regression(self) -> Regression:
        """Residuals, derivatives, covariance and confidence band as arrays, each with its shape and unit."""
        return _arrays(self._records, self._base, self.machine, False)


@dataclass(frozen=True, repr=False)
class Verdict(Drawn[doc.VerdictDocument]):
    """What a model lacks. The document has ``verdict``, ``where``, ``effects``, ``gap`` and more."""

    #: The model with the added effects; the given model is never changed.
    model: Machine = field(kw_only=True)
    #: The report as one page.
    html: str = field(default="", repr=False)
    #: The law's file of a curve, if one was requested and something was unexplained.
    laws: str | None = field(default=None, repr=False)
    _records: list[Record] = field(default_factory=list, repr=False, compare=False)
    _base: Machine | None = field(default=None, repr=False, compare=False)

    @cached_property
    def regression(self) -> Regression:
        """Residuals, derivatives, covariance and confidence band as arrays, each with its shape and unit."""
        return _arrays(self._records, self._base, self.model, True)

    def _facts(self) -> list[tuple[str, str]]:
        facts: list[tuple[str, str]] = [("verdict", self.verdict)]
        facts += [(effect["name"], _intervals(effect)) for effect in self.effects]
        facts += [(f"{effect['name']} corrected", _intervals(effect)) for effect in self.document["refined"]]
        gap = self.document["gap"]
        if isinstance(gap, dict):
            facts += [(f"gap {name}", short(v)) for name, v in gap.items() if isinstance(v, (int, float))]
        return facts

    @property
    def verdict(self) -> str:
        """``named``, ``nothing_missing``, ``unknown_effect`` or ``not_separable``."""
        return self.document["verdict"]

    @property
    def effects(self) -> list[doc.Effect]:
        """Added effects, strongest first: name, parameters with intervals, p-value, alternatives."""
        return self.document["effects"]


@dataclass(frozen=True, repr=False)
class Simulation(Result[dict[str, Any]]):
    """An experiment's figures, and its records, which are not yet written."""

    records: list[Record] = field(default_factory=list)

    def _facts(self) -> list[tuple[str, str]]:
        return [("records", ", ".join(run.file for run in self.records)), *super()._facts()]
