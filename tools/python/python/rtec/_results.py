"""What the functions give back."""

from __future__ import annotations

import json as _json
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rtec._machine import Machine
    from rtec._record import Record


class InputWarning(UserWarning):
    """What to know about the input before the result is used."""


def say(said: list[str], depth: int = 3) -> tuple[str, ...]:
    """Lines said on the way: warnings become Python's, at the caller's line."""
    for line in said:
        if line.startswith("warning: "):
            warnings.warn(line.removeprefix("warning: "), InputWarning, stacklevel=depth)
    return tuple(said)


#: A plot as data: ``kind`` is ``chart`` (series over an axis), ``polar`` (deviations from a circle, µm) or ``vectors`` (µm at places in mm).
Picture = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """A document: as text, and as dictionaries and lists."""

    #: The document as ``rtecctl … --json`` prints it, without the last line's end.
    json: str = field(repr=False)

    @cached_property
    def document(self) -> Any:
        """The document as dictionaries, lists, numbers and strings."""
        return _json.loads(self.json)


@dataclass(frozen=True)
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
        """The plots of its report, as figures of matplotlib."""
        from rtec import plots

        return plots.of(self)


@dataclass(frozen=True)
class Evaluation(Drawn):
    """Figures of a standard; keys as the standard's symbols (``A``, ``E_up``, ``R`` …), in µm."""

    #: The report as text.
    text: str = field(default="", repr=False)
    #: The report as one page, plots inside, ready to print.
    html: str = field(default="", repr=False)


@dataclass(frozen=True)
class Fit(Drawn):
    """A fit: how it was found (the document), and the model with it."""

    machine: Machine = field(default=None, repr=False)  # type: ignore[assignment]


@dataclass(frozen=True)
class ChainFit(Drawn):
    """A chain's fit: ``terms`` with value and interval, ``rms_um`` before and after for each record and response."""

    #: The chain's file with its coefficients in place; comments and order stay.
    text: str = field(default="", repr=False)

    def write(self, path: str | Path) -> None:
        """Writes the chain whole or not at all."""
        whole(path, self.text)


@dataclass(frozen=True)
class Validation(Drawn):
    """A model judged on records: ``responses`` (``rms``, ``rms_without_model``, ``coverage`` …), ``no_better``, ``suspicions``."""

    @property
    def no_better(self) -> list[str]:
        """Responses that the model explains no better than nothing does; `rtecctl` exits with 1 then."""
        return list(self.document["no_better"])


@dataclass(frozen=True)
class Table(Result):
    """A controller's table: ``points``, ``step_mm``, what it leaves of the model (``max_up_um``, ``rms_um`` …), ``warnings``."""

    #: The file's text.
    text: str = field(default="", repr=False)
    said: tuple[str, ...] = ()

    def write(self, path: str | Path) -> None:
        """Writes the file whole or not at all."""
        whole(path, self.text)


@dataclass(frozen=True)
class Verdict(Drawn):
    """What a model lacks: ``verdict``, ``where``, ``effects``, ``gap`` and more stand in the document."""

    #: The model with what was added; the one that was given is never touched.
    model: Machine = field(default=None, repr=False)  # type: ignore[assignment]
    #: The report as one page.
    html: str = field(default="", repr=False)
    #: Where something has no name and a curve was wanted: the file of its law.
    laws: str | None = field(default=None, repr=False)

    @property
    def verdict(self) -> str:
        """``named``, ``nothing_missing``, ``unknown_effect`` or ``not_separable``."""
        return str(self.document["verdict"])

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was added, strongest first: name, parameters with intervals, p-value, alternatives."""
        return list(self.document["effects"])


@dataclass(frozen=True)
class Plan(Result):
    """A sequence of runs; the document is a list of them."""

    #: The sequence as Markdown.
    markdown: str = field(default="", repr=False)
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class Design(Result):
    """Designs of insertion side by side."""

    #: The comparison as a table.
    text: str = field(default="", repr=False)


@dataclass(frozen=True)
class Replay(Result):
    """What the controller would have counted."""

    #: No fault was latched, the ledger balances, no transition at the controller was illegal.
    sound: bool = False


@dataclass(frozen=True)
class PartErrors(Drawn):
    """A feature's errors: ``errors`` (``angle_rad``, ``error_um``), ``centre_mm``, ``sd_before_um`` …"""

    #: The table for the finish cut, ``error.cor``.
    error_cor: str = field(default="", repr=False)
    #: Points and whiskers, as SVG.
    whisker_svg: str = field(default="", repr=False)


@dataclass(frozen=True)
class Simulation(Result):
    """An experiment's figures, and its records: not written yet."""

    records: list[Record] = field(default_factory=list)


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
