"""What the functions give back."""

from __future__ import annotations

import html as _html
import json as _json
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtec._errors import for_python, needs
from rtec._regression import Regression, regression

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rtec import _rtec
    from rtec._machine import Machine
    from rtec._record import Record


class InputWarning(UserWarning):
    """What to know about the input before the result is used."""


def say(said: list[str], depth: int = 3) -> tuple[str, ...]:
    """Lines said on the way: warnings become Python's, at the caller's line."""
    for line in said:
        if line.startswith("warning: "):
            warnings.warn(for_python(line.removeprefix("warning: ")), InputWarning, stacklevel=depth)
    return tuple(said)


#: A plot as data: ``kind`` is ``chart`` (series over an axis), ``polar`` (deviations from a circle, µm) or ``vectors`` (µm at places in mm).
Picture = dict[str, Any]


def table(title: str, head: list[str], rows: list[list[str]]) -> str:
    """A small table for a notebook."""

    def line(tag: str, cells: list[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{_html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table><caption>{_html.escape(title)}</caption>{line('th', head)}{body}</table>"


def _intervals(effect: dict[str, Any]) -> str:
    """The parameters of an effect with their 95 % intervals."""
    parameters = effect.get("parameters", {})
    each = [(name, *(_short(p[key]) for key in ("value", "low", "high"))) for name, p in parameters.items() if "low" in p]
    return ", ".join(f"{name} = {value} ({low} to {high})" for name, value, low, high in each)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, repr=False)
class Result:
    """A document: as text, and as dictionaries and lists."""

    #: The document as ``rtecctl … --json`` prints it, without the last line's end.
    json: str = field(repr=False)

    @cached_property
    def document(self) -> Any:
        """The document as dictionaries, lists, numbers and strings."""
        return _json.loads(self.json)

    def _facts(self) -> list[tuple[str, str]]:
        """What a person wants to see first: figures and words that the document holds at its top."""
        if isinstance(self.document, list):
            return [("entries", str(len(self.document)))]
        plain = (bool, int, float, str)
        return [(name, _short(v)) for name, v in self.document.items() if isinstance(v, plain)][:12]

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self._facts())
        return f"<rtec.{type(self).__name__} {facts}>"

    def _repr_html_(self) -> str:
        return table(type(self).__name__, ["", ""], [list(fact) for fact in self._facts()])


@dataclass(frozen=True, repr=False)
class Drawn(Result):
    """A result with plots, and with what was said on the way."""

    pictures_json: str = field(repr=False)
    #: What was said on the way, a line each.
    said: tuple[str, ...] = ()

    @cached_property
    def pictures(self) -> list[Picture]:
        """The plots of its report, as data."""
        return list(_json.loads(self.pictures_json))

    def plots(self) -> list[Figure]:
        """The plots of its report, as figures of matplotlib.

        Returns
        -------
        list of matplotlib.figure.Figure
        """
        try:
            from rtec import plots
        except ModuleNotFoundError:
            raise needs("matplotlib", "plots") from None
        return plots.of(self)


@dataclass(frozen=True, repr=False)
class Evaluation(Drawn):
    """Figures of a standard; keys as the standard's symbols (``A``, ``E_up``, ``R`` …), in µm."""

    #: The report as text.
    text: str = field(default="", repr=False)
    #: The report as one page, plots inside, ready to print.
    html: str = field(default="", repr=False)


@dataclass(frozen=True, repr=False)
class Fit(Drawn):
    """A fit: how it was found (the document), and the model with it."""

    machine: Machine = field(default=None, repr=False)  # type: ignore[assignment]
    _records: list[_rtec.Record] = field(default_factory=list, repr=False, compare=False)
    _base: _rtec.Machine | None = field(default=None, repr=False, compare=False)

    @cached_property
    def regression(self) -> Regression:
        """Residuals, derivatives, covariance and confidence band as arrays, each with its shape and unit."""
        return regression(self._records, self._base, self.machine._inner, False)


@dataclass(frozen=True, repr=False)
class ChainFit(Drawn):
    """A chain's fit: ``terms`` with value and interval, ``rms_um`` before and after for each record and response."""

    #: The chain's file with its coefficients in place; comments and order stay.
    text: str = field(default="", repr=False)

    def write(self, path: str | Path) -> None:
        """Writes the chain whole or not at all.

        Parameters
        ----------
        path : path
            Where it is, or will be.
        """
        whole(path, self.text)


@dataclass(frozen=True, repr=False)
class Validation(Drawn):
    """A model judged on records: ``responses`` (``rms``, ``rms_without_model``, ``coverage`` …), ``no_better``, ``suspicions``."""

    @property
    def no_better(self) -> list[str]:
        """Responses that the model explains no better than nothing does; `rtecctl` exits with 1 then."""
        return list(self.document["no_better"])


@dataclass(frozen=True, repr=False)
class Table(Result):
    """A controller's table: ``points``, ``step_mm``, what it leaves of the model (``max_up_um``, ``rms_um`` …), ``warnings``."""

    #: The file's text.
    text: str = field(default="", repr=False)
    said: tuple[str, ...] = ()

    def write(self, path: str | Path) -> None:
        """Writes the file whole or not at all.

        Parameters
        ----------
        path : path
            Where it is, or will be.
        """
        whole(path, self.text)


@dataclass(frozen=True, repr=False)
class Verdict(Drawn):
    """What a model lacks: ``verdict``, ``where``, ``effects``, ``gap`` and more stand in the document."""

    #: The model with what was added; the one that was given is never touched.
    model: Machine = field(default=None, repr=False)  # type: ignore[assignment]
    #: The report as one page.
    html: str = field(default="", repr=False)
    #: Where something has no name and a curve was wanted: the file of its law.
    laws: str | None = field(default=None, repr=False)
    _records: list[_rtec.Record] = field(default_factory=list, repr=False, compare=False)
    _base: _rtec.Machine | None = field(default=None, repr=False, compare=False)

    @cached_property
    def regression(self) -> Regression:
        """Residuals, derivatives, covariance and confidence band as arrays, each with its shape and unit."""
        return regression(self._records, self._base, self.model._inner, True)

    def _facts(self) -> list[tuple[str, str]]:
        facts = [("verdict", self.verdict)]
        for effect in self.effects:
            facts.append((str(effect["name"]), _intervals(effect)))
        for effect in self.document.get("refined", []):
            facts.append((f"{effect['name']} corrected", _intervals(effect)))
        gap = self.document.get("gap")
        if isinstance(gap, dict):
            facts += [(f"gap {name}", _short(v)) for name, v in gap.items() if isinstance(v, (int, float))]
        return facts

    @property
    def verdict(self) -> str:
        """``named``, ``nothing_missing``, ``unknown_effect`` or ``not_separable``."""
        return str(self.document["verdict"])

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was added, strongest first: name, parameters with intervals, p-value, alternatives."""
        return list(self.document["effects"])


@dataclass(frozen=True, repr=False)
class Plan(Result):
    """A sequence of runs; the document is a list of them."""

    #: The sequence as Markdown.
    markdown: str = field(default="", repr=False)
    said: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Design(Result):
    """Designs of insertion side by side."""

    #: The comparison as a table.
    text: str = field(default="", repr=False)


@dataclass(frozen=True, repr=False)
class Replay(Result):
    """What the controller would have counted."""

    #: No fault was latched, the ledger balances, no transition at the controller was illegal.
    sound: bool = False


@dataclass(frozen=True, repr=False)
class PartErrors(Drawn):
    """A feature's errors: ``errors`` (``angle_rad``, ``error_um``), ``centre_mm``, ``sd_before_um`` …"""

    #: The table for the finish cut, ``error.cor``.
    error_cor: str = field(default="", repr=False)
    #: Points and whiskers, as SVG.
    whisker_svg: str = field(default="", repr=False)


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """An experiment's figures, and its records: not written yet."""

    records: list[Record] = field(default_factory=list)

    def _facts(self) -> list[tuple[str, str]]:
        return [("records", ", ".join(run.file for run in self.records)), *super()._facts()]


def whole(path: str | Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    import os
    import tempfile

    path = Path(path)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, encoding="utf-8", newline="", delete=False) as file:
        try:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            os.unlink(file.name)
            raise
    os.replace(file.name, path)
