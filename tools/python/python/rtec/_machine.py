"""Machine models: reading, prediction, validation, writing."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, cast

from rtec import _documents as doc
from rtec import _rtec
from rtec._alike import documented, place
from rtec._record import Numbers, Place, Record, Runs, inners
from rtec._results import Table, Validation
from rtec._text import say


class Machine:
    """A machine model: a named list of effects, the content of one ``machine.toml``."""

    def __init__(self, inner: _rtec.Machine) -> None:
        self._inner = inner

    @staticmethod
    def ideal(name: str) -> Machine:
        """A machine without errors.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Machine
        """
        return Machine(_rtec.Machine.ideal(name))

    @staticmethod
    def parse(text: str, path: Place | None = None) -> Machine:
        """A model from the text of a ``machine.toml``.

        ``path`` is for messages and for the files that the model names.

        Parameters
        ----------
        text : str
            TOML.
        path : path, optional
            For messages, and for the files that it names.

        Returns
        -------
        Machine
        """
        return Machine(_rtec.Machine.parse(text, place(path)))

    def __repr__(self) -> str:
        return repr(self._inner)

    def __reduce__(self) -> tuple[Any, ...]:
        return Machine.parse, (self.text, self.path)

    @property
    def name(self) -> str:
        """The machine's name."""
        return self._inner.name

    @property
    def path(self) -> str:
        """The file, as the user named it."""
        return self._inner.path

    @property
    def sha256(self) -> str:
        """SHA-256 of the file as it was read."""
        return self._inner.sha256

    @property
    def sensors(self) -> list[str]:
        """Sensors that its effects read."""
        return self._inner.sensors

    @property
    def text(self) -> str:
        """The text of its ``machine.toml``, with its comments."""
        return self._inner.to_text()

    @property
    def json(self) -> str:
        """The text that ``rtecctl model show --json`` prints."""
        return self._inner.to_json()

    @property
    def document(self) -> doc.MachineDocument:
        """``effects`` (name, law, parameters with value, unit and interval), ``fits``, ``chain``."""
        return cast(doc.MachineDocument, json.loads(self.json))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Its effects, in the file's order."""
        return list(self.document["effects"])

    @documented
    def write(self, path: Place) -> None:
        """Writes it whole or not at all, and only if it can be read again."""
        self._inner.write(os.fspath(path))

    @documented
    def predict(self, run: Record) -> dict[str, Numbers]:
        """Predicts a record: the sum of the effects at every row.

        Returns
        -------
        dict of str to ndarray
            By the response's column name; µm (N for forces), shape ``(len(run),)``.
        """
        columns, said = self._inner.predict(run._inner)
        say(said)
        return columns

    @documented
    def predicted_csv(self, run: Record, *, interval: bool = False) -> str:
        """The record's CSV with ``predicted_…`` columns, as ``rtecctl model predict`` writes it.

        Parameters
        ----------
        interval : bool
            Whether to add half widths of the 95 % interval.

        Returns
        -------
        str
        """
        text, said = self._inner.predicted_csv(run._inner, interval)
        say(said)
        return text

    @documented
    def half_widths_um(self, run: Record, response: str) -> Numbers | None:
        """Half width of a response's 95 % interval at every row, µm; None if no fit states one.

        Parameters
        ----------
        response : str
            As ``error.y``.

        Returns
        -------
        ndarray or None
            Half width of the 95 % interval, µm, shape ``(len(run),)``.
        """
        return self._inner.half_widths_um(run._inner, response)

    @documented
    def validate(self, runs: Runs) -> Validation:
        """Judges it on records that it has not seen: residuals, and rows inside its interval.

        Returns
        -------
        Validation
        """
        (document, pictures), said = _rtec.validate(self._inner, inners(runs))
        return Validation(document, pictures, say(said))

    @documented
    def export(
        self,
        axis: str,
        from_mm: float,
        to_mm: float,
        *,
        format: str = "linuxcnc",
        step_mm: float | None = None,
        limit_um: float = 0.5,
        max_points: int | None = None,
        temperatures: Mapping[str, float] | None = None,
        at_mm: Mapping[str, float] | None = None,
        unit: str = "mm",
        along: str | None = None,
        along_name: str | None = None,
        table: int = 0,
        positive_moves: str | None = None,
        axis_name: str | None = None,
        encoder: int = 0,
        reference_mm: float | None = None,
        axis_number: int | None = None,
        form: Place | None = None,
    ) -> Table:
        """One axis' errors as a table for a controller that compensates by itself.

        ``format``: ``linuxcnc``, ``linuxcnc-type1``, ``ssfk`` (with ``axis_number``), ``siemens`` (with ``axis_name`` and
        ``reference_mm``), ``siemens-cec`` (with ``along``, ``along_name``, ``positive_moves`` and ``table`` beside those),
        ``csv`` or ``own`` (with ``form``). ``along``: another axis that the table goes along (squareness, straightness, sag).
        ``temperatures`` in °C by sensor, others are at 20; ``at_mm``: positions of the other axes, else 0. ``limit_um``: largest
        deviation of the table from the model between its positions.

        Parameters
        ----------
        axis : str
            The axis that is compensated.
        from_mm : float
            Its first position, mm.
        to_mm : float
            Its last position, mm.
        step_mm : float, optional
            Between positions, mm.
        limit_um : float
            Largest deviation of the table from the model between positions, µm.
        max_points : int, optional
            Largest number of points that the controller can hold.
        temperatures : mapping of str to float, optional
            °C by sensor; others are at 20.
        at_mm : mapping of str to float, optional
            Positions of the other axes, mm; else 0.
        along : str, optional
            Another axis that the table goes along.
        along_name : str, optional
            Siemens: that axis.
        table : int
            Siemens: the number of the table, from 0.
        positive_moves : str, optional
            Siemens: whether a positive value moves the axis ``up`` or ``down``.
        axis_name : str, optional
            Siemens: the axis.
        encoder : int
            Siemens: the encoder.
        reference_mm : float, optional
            Siemens: the reference point, mm.
        axis_number : int, optional
            ``ssfk``: the axis.

        Returns
        -------
        Table
        """
        asked: dict[str, Any] = {
            "axis": axis,
            "from_mm": float(from_mm),
            "to_mm": float(to_mm),
            "step_mm": step_mm,
            "limit_um": float(limit_um),
            "max_points": max_points,
            "temperatures_degc": [(name, float(v)) for name, v in (temperatures or {}).items()],
            "at_mm": [(name, float(v)) for name, v in (at_mm or {}).items()],
            "format": format,
            "unit": unit,
            "along": along,
            "along_name": along_name,
            "table": table,
            "positive_moves": positive_moves,
            "axis_name": axis_name,
            "encoder": encoder,
            "reference_mm": reference_mm,
            "axis_number": axis_number,
            "form": place(form),
        }
        (document, text), said = _rtec.export_table(self._inner, asked)
        return Table(document, text, say(said))

    @documented
    def beyond(self, run: Record) -> Record:
        """The record with the model's prediction subtracted from its responses.

        Returns
        -------
        Record
        """
        return Record(self._inner.beyond(run._inner))

    @documented
    def doubts(self, today: str | None = None) -> list[str]:
        """Warnings before it is used on a day (``YYYY-MM-DD``; by default today).

        Returns
        -------
        list of str
        """
        return self._inner.doubts(today)

    @documented
    def days_left(self, today: str | None = None) -> int | None:
        """Days until the first of its fits expires; None without fits.

        Returns
        -------
        int or None
        """
        return self._inner.days_left(today)


def read_machine(path: Place) -> Machine:
    """Reads a ``machine.toml``, strictly: the first finding raises :class:`InputError`.

    Parameters
    ----------
    path : path
        Where it is, or will be.

    Returns
    -------
    Machine
    """
    return Machine(_rtec.Machine.read(os.fspath(path)))


def a_machine(machine: Machine | Place) -> Machine:
    return machine if isinstance(machine, Machine) else read_machine(machine)


