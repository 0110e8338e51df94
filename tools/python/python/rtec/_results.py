"""The results of the functions."""

from __future__ import annotations

import json as _json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from rtec import _documents as doc
from rtec._alike import documented
from rtec._documents import Picture
from rtec._errors import needs
from rtec._regression import Regression
from rtec._text import table, whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

D = TypeVar("D")


def short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, repr=False)
class Result(Generic[D]):
    """A document: as text, and as dictionaries and lists."""

    #: The document as ``rtecctl … --json`` prints it, without the last line's end.
    json: str = field(repr=False)

    @cached_property
    def document(self) -> D:
        """The document as dictionaries, lists, numbers and strings."""
        return cast(D, _json.loads(self.json))

    def _facts(self) -> list[tuple[str, str]]:
        """The figures and words at the top level of the document, for a short display."""
        document: Any = self.document
        if isinstance(document, list):
            return [("entries", str(len(document)))]
        plain = (bool, int, float, str)
        shown = [(name, short(v)) for name, v in document.items() if isinstance(v, plain) and name not in ("format", "by")]
        return shown[:12]

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self._facts())
        return f"<rtec.{type(self).__name__} {facts}>"

    def _repr_html_(self) -> str:
        return table(type(self).__name__, ["", ""], [list(fact) for fact in self._facts()])


@dataclass(frozen=True, repr=False)
class Drawn(Result[D]):
    """A result with plots and messages."""

    pictures_json: str = field(repr=False)
    #: Messages, one line each.
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
            from rtec._draw import draw
        except ModuleNotFoundError:
            raise needs("matplotlib", "plots") from None
        return [draw(picture) for picture in self.pictures]


@dataclass(frozen=True, repr=False)
class Report(Drawn[D]):
    """Figures with a report."""

    #: The report as text.
    text: str = field(default="", repr=False)
    #: The report as one page, plots inside, ready to print.
    html: str = field(default="", repr=False)


@dataclass(frozen=True, repr=False)
class Evaluation(Report[doc.EvaluationDocument]):
    """Figures of a standard; keys as the standard's symbols (``A``, ``E_up``, ``R`` …), in µm."""


@dataclass(frozen=True, repr=False)
class History(Report[doc.HistoryDocument]):
    """One machine's figures over time: ``figures``, ``left_out``."""


@dataclass(frozen=True, repr=False)
class ChainFit(Drawn[doc.ChainFitDocument]):
    """A chain's fit: ``terms`` with value and interval, ``rms_um`` before and after."""

    #: The chain's file with its coefficients in place; comments and order stay.
    text: str = field(default="", repr=False)
    #: Residuals, derivatives, covariance and confidence band as arrays, each with its shape and unit.
    regression: Regression = field(kw_only=True, repr=False, compare=False)

    @documented
    def write(self, path: str | Path) -> None:
        """Writes the chain whole or not at all."""
        whole(path, self.text)


@dataclass(frozen=True, repr=False)
class Validation(Drawn[doc.ValidationDocument]):
    """A model judged on records.

    The document has ``responses`` (``rms``, ``rms_without_model``, ``coverage`` …), ``no_better`` and ``suspicions``."""

    @property
    def no_better(self) -> list[str]:
        """Responses that the model predicts no better than zero does; `rtecctl` exits with 1 then."""
        return list(self.document["no_better"])


@dataclass(frozen=True, repr=False)
class Table(Result[doc.TableDocument]):
    """A controller's table.

    The document has ``points``, ``step_mm``, residuals against the model (``max_up_um``, ``rms_um`` …) and ``warnings``."""

    #: The file's text.
    text: str = field(default="", repr=False)
    said: tuple[str, ...] = ()

    @documented
    def write(self, path: str | Path) -> None:
        """Writes the file whole or not at all."""
        whole(path, self.text)


@dataclass(frozen=True, repr=False)
class Plan(Result[list[doc.Step]]):
    """A sequence of runs; the document is a list of them."""

    #: The sequence as Markdown.
    markdown: str = field(default="", repr=False)
    said: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Design(Result[doc.DesignsDocument]):
    """Designs of insertion side by side."""

    #: The comparison as a table.
    text: str = field(default="", repr=False)


@dataclass(frozen=True, repr=False)
class Replay(Result[doc.ReplayDocument]):
    """The counts that the controller would have received."""

    #: Whether no fault was latched, the ledger balances, and the controller saw no illegal transition.
    sound: bool = False


@dataclass(frozen=True, repr=False)
class PartErrors(Drawn[doc.PartDocument]):
    """A feature's errors: ``errors`` (``angle_rad``, ``error_um``), ``centre_mm``, ``sd_before_um`` …"""

    #: The table for the finish cut, ``error.cor``.
    error_cor: str = field(default="", repr=False)
    #: Points and whiskers, as SVG.
    whisker_svg: str = field(default="", repr=False)
