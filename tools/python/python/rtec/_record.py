"""Run records: their columns as arrays, in and out of files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtec import _rtec
from rtec._results import say

if TYPE_CHECKING:
    import pandas as pd

Place = str | os.PathLike[str]
Numbers = NDArray[np.float64]


class Record:
    """One run: columns by name, rows in order of acquisition.

    ``run["e"]`` gives a column as an array of shape ``(len(run),)``; its name is the CSV's, or its label
    (``error.y``, ``temperature.T3``). Records do not change: what changes one gives another one.
    """

    def __init__(self, inner: _rtec.Record) -> None:
        self._inner = inner

    def __getitem__(self, name: str) -> Numbers:
        return self._inner[name]

    def __len__(self) -> int:
        return len(self._inner)

    def __repr__(self) -> str:
        return repr(self._inner)

    def __reduce__(self) -> tuple[Any, ...]:
        columns = {name: (role, self[name], unit) for name, role, unit in self.columns}
        about = {"count_um": self.count_um, "date": self.date, "note": self.note, "zero": self.zero}
        radius, plane = self._inner.circle or (None, None)
        return _again, (self.path, self.kind, columns, about, radius, plane)

    @property
    def path(self) -> str:
        """The sidecar, as it was named."""
        return self._inner.path

    @property
    def file(self) -> str:
        """The CSV, as the sidecar names it."""
        return self._inner.file

    @property
    def sha256(self) -> str:
        """SHA-256 of the CSV; empty for a record made in memory."""
        return self._inner.sha256

    @property
    def kind(self) -> str:
        """``positioning``, ``drift``, ``ballbar``, ``plate``, ``dynamics``, ``probing``, ``feed_sweep`` or ``part``."""
        return self._inner.kind

    @property
    def count_um(self) -> float | None:
        """What one count is worth, µm."""
        return self._inner.count_um

    @property
    def date(self) -> str | None:
        """The day of the run, ``YYYY-MM-DD``."""
        return self._inner.date

    @property
    def note(self) -> str | None:
        """Free words about the run."""
        return self._inner.note

    @property
    def zero(self) -> str | None:
        """The name of the gauges' zero."""
        return self._inner.zero

    @property
    def columns(self) -> list[tuple[str, str, str]]:
        """Name, role and unit of each column, in the CSV's order."""
        return self._inner.columns

    @property
    def responses(self) -> list[str]:
        """Names of the columns that are errors or forces."""
        return self._inner.responses

    @property
    def time_s(self) -> Numbers:
        """Time of every row, s; the row's number where no time was logged."""
        return self._inner.time_s

    def select(self, rows: ArrayLike) -> Record:
        """Some of its rows: numbers from 0, or a mask of shape ``(len(run),)``."""
        wanted = np.asarray(rows)
        if wanted.dtype == np.bool_:
            if wanted.shape != (len(self),):
                raise IndexError(f"a mask of shape {wanted.shape}, expected ({len(self)},)")
            wanted = np.flatnonzero(wanted)
        if wanted.size and (wanted.min() < 0 or wanted.ndim != 1):
            raise IndexError("rows are numbers from 0, in one dimension")
        return Record(self._inner.select([int(row) for row in wanted]))

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a DataFrame; roles and units stand in its ``attrs``."""
        import pandas as pd

        frame = pd.DataFrame({name: self[name] for name, _, _ in self.columns})
        frame.attrs = {name: {"role": role, "unit": unit} for name, role, unit in self.columns}
        return frame

    def to_csv(self) -> str:
        """The CSV's text; each number as the shortest decimal that reads back as the same."""
        return self._inner.to_csv()

    def to_sidecar(self) -> str:
        """The text of ``NAME.run.toml``."""
        return self._inner.to_sidecar()

    def write(self, path: Place | None = None) -> Record:
        """Writes sidecar and CSV, each whole or not at all; to ``path`` (``NAME.run.toml``) where it is given."""
        to = os.fspath(self.path if path is None else path)
        if os.path.basename(to) == ".run.toml":
            raise ValueError(f"found the file {to!r}, expected NAME.run.toml")
        return Record(self._inner.write(to))

    def suspicions(self) -> list[dict[str, Any]]:
        """Mistakes that the record itself shows: ``column``, ``rows``, ``what``, ``text``."""
        return list(json.loads(self._inner.suspicions()))


def _again(
    path: str,
    kind: str,
    columns: Mapping[str, tuple[Any, ...]],
    about: Mapping[str, Any],
    radius: float | None,
    plane: tuple[str, str] | None,
) -> Record:
    return record(path, kind, columns, radius_mm=radius, plane=plane, log=True, **about)


def _numbers(name: str, role: str, values: Any) -> Numbers:
    """Values as numbers of the role's unit. What numpy would turn into numbers of another meaning is refused."""
    if np.ma.isMaskedArray(values) and np.ma.getmaskarray(values).any():
        raise ValueError(f"column {name!r}: found masked values, expected a number in every row: leave those rows out")
    found = np.asarray(values)
    if found.dtype.kind == "m" and role == "time":
        found = found / np.timedelta64(1, "s")
    if found.dtype.kind in "mMcSU":
        expected = "seconds since the run began, as (t - t[0])" if found.dtype.kind == "M" else "numbers"
        raise TypeError(f"column {name!r}: found values of type {found.dtype}, expected {expected}")
    return np.ascontiguousarray(found, dtype=np.float64)


def read_record(path: Place, *, log: bool = False) -> Record:
    """Reads a run record from its sidecar ``NAME.run.toml``; ``log``: it need not have a response."""
    return Record(_rtec.Record.read(os.fspath(path), log=log))


def record(
    path: Place,
    kind: str,
    columns: Mapping[str, tuple[Any, ...]] | pd.DataFrame,
    roles: Mapping[str, str] | None = None,
    *,
    count_um: float | None = None,
    date: str | None = None,
    note: str | None = None,
    zero: str | None = None,
    radius_mm: float | None = None,
    plane: tuple[str, str] | None = None,
    log: bool = False,
) -> Record:
    """Makes a record in memory; :meth:`Record.write` puts it into files; ``log``: it need not have a response.

    ``columns``: for each name its role and values, and for a channel its unit:
    ``{"y": ("position.y", y_mm), "e": ("error.y", e_um), "p": ("channel", p, "bar")}``; or a DataFrame with ``roles`` by name
    (columns without a role are left out). Values are in the role's unit, one per row, finite; a time may be ``timedelta64``. ``path`` is where it will stand.
    """
    if roles is not None:
        columns = {name: (role, np.asarray(columns[name])) for name, role in roles.items()}
    given: list[tuple[str, str, str | None, Numbers]] = []
    for name, of in columns.items():
        if not isinstance(of, tuple) or len(of) not in (2, 3):
            raise TypeError(f"column {name!r}: expected (role, values) or (role, values, unit)")
        values = _numbers(str(name), str(of[0]), of[1])
        if values.ndim != 1:
            raise ValueError(f"column {name!r}: values of shape {values.shape}, expected one dimension")
        given.append((str(name), str(of[0]), of[2] if len(of) == 3 else None, values))
    if (radius_mm is None) != (plane is None):
        raise ValueError("radius_mm and plane stand together: a ballbar's length and its two axes")
    circle = None if radius_mm is None or plane is None else (radius_mm, list(plane))
    inner = _rtec.Record(
        os.fspath(path), kind, given, count_um=count_um, date=date, note=note, zero=zero, circle=circle, log=log
    )
    return Record(inner)


def import_record(
    file: Place,
    format: str,
    out: Place,
    *,
    axis: str | None = None,
    columns: Sequence[str] | Mapping[str, str] = (),
    kind: str = "drift",
    decimal: str | None = None,
    log: bool = False,
    period_s: float | None = None,
    numbered: bool = False,
    unit: str = "mm",
    form: Place | None = None,
    derive: bool = False,
    radius_mm: float | None = None,
    plane: tuple[str, str] | None = None,
) -> Record:
    """Another tool's file as a record, which is not written yet: :meth:`Record.write`.

    ``format``: ``csv``, ``own``, ``rtl``, ``etalon``, ``halsampler``, ``shdr``, ``cmm-plate``, ``ecmc-dat``, ``linuxcnc-comp0`` or
    ``linuxcnc-comp1``. ``columns``: roles by name, with the unit where it is not the role's own, ``{"gz": "error.z:mm"}``.
    ``decimal``: ``point`` or ``comma``. ``out``: where it will stand, ``NAME.run.toml``.
    """
    if decimal not in (None, "point", "comma"):
        raise ValueError(f"found decimal {decimal!r}, expected 'point' or 'comma'")
    if (radius_mm is None) != (plane is None):
        raise ValueError("radius_mm and plane stand together: a ballbar's length and its two axes")
    named = [f"{name}={role}" for name, role in columns.items()] if isinstance(columns, Mapping) else list(columns)
    asked: dict[str, Any] = {
        "file": os.fspath(file),
        "format": format,
        "out": os.fspath(out),
        "axis": axis,
        "columns": named,
        "kind": kind,
        "decimal_comma": None if decimal is None else decimal == "comma",
        "log": log,
        "period_s": period_s,
        "numbered": numbered,
        "unit": unit,
        "form": None if form is None else os.fspath(form),
        "derive": derive,
        "radius_mm": radius_mm,
        "plane": None if plane is None else list(plane),
    }
    inner, said = _rtec.import_record(asked)
    say(said)
    return Record(inner)


Runs = Record | Place | Iterable[Record | Place]


def inners(runs: Runs) -> list[_rtec.Record]:
    many: Iterable[Record | Place] = [runs] if isinstance(runs, (Record, str, os.PathLike)) else runs
    return [run._inner if isinstance(run, Record) else read_record(run)._inner for run in many]


