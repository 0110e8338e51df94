"""Run records: their columns as arrays, read from files and written to them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtec import _rtec
from rtec._alike import documented, place
from rtec._documents import Suspicion
from rtec._errors import names, needs
from rtec._text import say, table

if TYPE_CHECKING:
    import pandas as pd

Place = str | os.PathLike[str]
Numbers = NDArray[np.float64]


class Record:
    """One run: columns by name, rows in order of acquisition.

    ``run["e"]`` gives a column as an array of shape ``(len(run),)``; its name is the CSV's, or its label
    (``error.y``, ``temperature.T3``). ``len(run)`` counts rows; iteration and ``in`` go over the columns' names.
    Records do not change: a method that changes one returns another.
    """

    def __init__(self, inner: _rtec.Record) -> None:
        self._inner = inner

    def __getitem__(self, name: str) -> Numbers:
        return self._inner[name]

    def __len__(self) -> int:
        return len(self._inner)

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and self._inner[name] is not None
        except KeyError:
            return False

    def keys(self) -> list[str]:
        """Names of its columns, in the CSV's order.

        Returns
        -------
        list of str
        """
        return [name for name, _, _ in self.columns]

    def __repr__(self) -> str:
        return repr(self._inner)

    def _repr_html_(self) -> str:
        head = ["column", "role", "unit", "least", "most"]
        rows = [[n, r, u, f"{self[n].min():.6g}", f"{self[n].max():.6g}"] for n, r, u in self.columns]
        return table(f"{self.kind}, {len(self)} rows: {self.path}", head, rows)

    def __reduce__(self) -> tuple[Any, ...]:
        columns = {name: (role, self[name], unit) for name, role, unit in self.columns}
        about = {"count_um": self.count_um, "date": self.date, "note": self.note, "zero": self.zero}
        radius, plane = self._inner.circle or (None, None)
        return _again, (self.path, self.kind, columns, about, radius, plane, self.sha256)

    @property
    def path(self) -> str:
        """The sidecar, as the user named it."""
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
        """The length of one count, µm."""
        return self._inner.count_um

    @property
    def date(self) -> str | None:
        """The day of the run, ``YYYY-MM-DD``."""
        return self._inner.date

    @property
    def note(self) -> str | None:
        """Free text about the run."""
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
        """Time of every row, s; the row's number if no time was logged."""
        return self._inner.time_s

    def select(self, rows: ArrayLike) -> Record:
        """Some of its rows: numbers from 0, or a mask of shape ``(len(run),)``.

        Parameters
        ----------
        rows : array_like of int or bool
            Numbers from 0, or a mask of shape ``(len(run),)``.

        Returns
        -------
        Record
        """
        wanted = np.asarray(rows)
        if wanted.dtype == np.bool_:
            if wanted.shape != (len(self),):
                raise IndexError(f"a mask of shape {wanted.shape}, expected ({len(self)},)")
            wanted = np.flatnonzero(wanted)
        if wanted.size and (wanted.min() < 0 or wanted.ndim != 1):
            raise IndexError("rows are numbers from 0, in one dimension")
        return Record(self._inner.select([int(row) for row in wanted]))

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a DataFrame; its ``attrs`` have roles and units.

        Returns
        -------
        pandas.DataFrame
            ``len(run)`` rows, a column for each of the record's.
        """
        try:
            import pandas as pd
        except ModuleNotFoundError:
            raise needs("pandas", "frames") from None
        frame = pd.DataFrame({name: self[name] for name, _, _ in self.columns})
        frame.attrs = {name: {"role": role, "unit": unit} for name, role, unit in self.columns}
        return frame

    def to_csv(self) -> str:
        """The CSV's text; each number as the shortest decimal that reads back as the same.

        Returns
        -------
        str
        """
        return self._inner.to_csv()

    def to_sidecar(self) -> str:
        """The text of ``NAME.run.toml``.

        Returns
        -------
        str
        """
        return self._inner.to_sidecar()

    def write(self, path: Place | None = None) -> Record:
        """Writes sidecar and CSV, each whole or not at all.

        Parameters
        ----------
        path : path, optional
            ``NAME.run.toml``; its own path if left out.

        Returns
        -------
        Record
            The same record, with the hash of the written file.
        """
        to = os.fspath(self.path if path is None else path)
        if os.path.basename(to) == ".run.toml":
            raise ValueError(f"found the file {to!r}, expected NAME.run.toml")
        return Record(self._inner.write(to))

    def suspicions(self) -> list[Suspicion]:
        """Mistakes that the record itself shows: ``column``, ``rows``, ``what``, ``text``.

        Returns
        -------
        list of dict
        """
        return list(json.loads(self._inner.suspicions()))


def _again(
    path: str,
    kind: str,
    columns: Mapping[str, tuple[Any, ...]],
    about: Mapping[str, Any],
    radius: float | None,
    plane: tuple[str, str] | None,
    sha256: str = "",
) -> Record:
    return _made(path, kind, columns, None, about, radius, plane, True, sha256)


def _numbers(name: str, role: str, values: Any) -> Numbers:
    """Values as numbers in the role's unit.

    Values that numpy would convert to numbers of another meaning are refused."""
    if np.ma.isMaskedArray(values) and np.ma.getmaskarray(values).any():
        raise ValueError(f"column {name!r}: found masked values, expected a number in every row: leave those rows out")
    found = np.asarray(values)
    if found.dtype.kind == "m" and role == "time":
        found = found / np.timedelta64(1, "s")
    if found.dtype.kind in "mMcSU":
        expected = "seconds since the run began, as (t - t[0])" if found.dtype.kind == "M" else "numbers"
        raise TypeError(f"column {name!r}: found values of type {found.dtype}, expected {expected}")
    return np.ascontiguousarray(found, dtype=np.float64)


@documented
def read_record(path: Place, *, log: bool = False) -> Record:
    """Reads a run record from its sidecar ``NAME.run.toml``.

    ``log``: it need not have a response.

    Returns
    -------
    Record
    """
    return Record(_rtec.Record.read(os.fspath(path), log=log))


@documented
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
    """Makes a record in memory; :meth:`Record.write` puts it into files.

    ``log``: it need not have a response. ``columns``: for each name its role and values, and for a channel its unit:
    ``{"y": ("position.y", y_mm), "e": ("error.y", e_um), "p": ("channel", p, "bar")}``; or a DataFrame with ``roles`` by name
    (columns without a role are left out). Values are in the role's unit, one per row, finite; a time may be ``timedelta64``.
    ``path`` is the file that it will be written to.

    Parameters
    ----------
    columns : mapping or pandas.DataFrame
        Role and values by name; each array has shape ``(rows,)``.
    roles : mapping of str to str, optional
        Roles by the DataFrame's columns.
    count_um : float, optional
        The length of one count, µm.
    note : str, optional
        Free text.
    zero : str, optional
        Name of the gauges' zero.

    Returns
    -------
    Record
    """
    about = {"count_um": count_um, "date": date, "note": note, "zero": zero}
    return _made(path, kind, columns, roles, about, radius_mm, plane, log, None)


def _made(
    path: Place,
    kind: str,
    columns: Mapping[str, tuple[Any, ...]] | pd.DataFrame,
    roles: Mapping[str, str] | None,
    about: Mapping[str, Any],
    radius_mm: float | None,
    plane: tuple[str, str] | None,
    log: bool,
    sha256: str | None,
) -> Record:
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
    circle = None if radius_mm is None or plane is None else (radius_mm, names("plane", plane))
    inner = _rtec.Record(
        os.fspath(path), kind, given, circle=circle, log=log, sha256=sha256, **about
    )
    return Record(inner)


@documented
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
    """Another tool's file as a record; :meth:`Record.write` puts it into files.

    ``format``: ``csv``, ``own``, ``rtl``, ``etalon``, ``halsampler``, ``shdr``, ``cmm-plate``, ``ecmc-dat``, ``linuxcnc-comp0`` or
    ``linuxcnc-comp1``. ``columns``: roles by name, with the unit if it is not the role's own, ``{"gz": "error.z:mm"}``.
    ``decimal``: ``point`` or ``comma``. ``out``: the file that it will be written to, ``NAME.run.toml``.

    Parameters
    ----------
    file : path
        The other tool's file.
    axis : str, optional
        The axis that was measured.
    columns : mapping or sequence of str
        Roles by name, with the unit if it is not the role's own.
    decimal : str, optional
        ``point`` or ``comma``.
    period_s : float, optional
        Time between rows, s.
    numbered : bool
        The first column numbers the rows.
    derive : bool
        Add velocity and acceleration.

    Returns
    -------
    Record
    """
    if decimal not in (None, "point", "comma"):
        raise ValueError(f"found decimal {decimal!r}, expected 'point' or 'comma'")
    if (radius_mm is None) != (plane is None):
        raise ValueError("radius_mm and plane stand together: a ballbar's length and its two axes")
    named = [f"{name}={role}" for name, role in columns.items()] if isinstance(columns, Mapping) else names("columns", columns)
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
        "form": place(form),
        "derive": derive,
        "radius_mm": radius_mm,
        "plane": None if plane is None else names("plane", plane),
    }
    inner, said = _rtec.import_record(asked)
    say(said)
    return Record(inner)


Runs = Record | Place | Iterable[Record | Place]


def inners(runs: Runs) -> list[_rtec.Record]:
    many: Iterable[Record | Place] = [runs] if isinstance(runs, (Record, str, os.PathLike)) else runs
    return [run._inner if isinstance(run, Record) else read_record(run)._inner for run in many]


