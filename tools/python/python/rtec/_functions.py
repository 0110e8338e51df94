"""The functions, with what a reader of Python expects of them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtec import _rtec
from rtec._results import (
    Design,
    Evaluation,
    Fit,
    PartErrors,
    Plan,
    Replay,
    Result,
    Simulation,
    Verdict,
    say,
    whole,
)

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
        return Record(self._inner.write(None if path is None else os.fspath(path)))

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
    (columns without a role are left out). Values are in the role's unit, one per row, finite. ``path`` is where it will stand.
    """
    if roles is not None:
        columns = {name: (role, np.asarray(columns[name])) for name, role in roles.items()}
    given: list[tuple[str, str, str | None, Numbers]] = []
    for name, of in columns.items():
        if not isinstance(of, tuple) or len(of) not in (2, 3):
            raise TypeError(f"column {name!r}: expected (role, values) or (role, values, unit)")
        values = np.ascontiguousarray(of[1], dtype=np.float64)
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


class Machine:
    """A machine model: a named list of effects, the content of one ``machine.toml``."""

    def __init__(self, inner: _rtec.Machine) -> None:
        self._inner = inner

    @staticmethod
    def ideal(name: str) -> Machine:
        """A machine without errors."""
        return Machine(_rtec.Machine.ideal(name))

    @staticmethod
    def parse(text: str, path: Place | None = None) -> Machine:
        """A model from the text of a ``machine.toml``; ``path`` for messages and for the files that it names."""
        return Machine(_rtec.Machine.parse(text, None if path is None else os.fspath(path)))

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
        """The file, as it was named."""
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
        """The text of its ``machine.toml``, comments and all."""
        return self._inner.to_text()

    @property
    def json(self) -> str:
        """What ``rtecctl model show --json`` prints."""
        return self._inner.to_json()

    @property
    def document(self) -> dict[str, Any]:
        """``effects`` (name, law, parameters with value, unit and interval), ``fits``, ``chain``."""
        return dict(json.loads(self.json))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Its effects, in the file's order."""
        return list(self.document["effects"])

    def write(self, path: Place) -> None:
        """Writes it whole or not at all; what would not be read again is not written."""
        self._inner.write(os.fspath(path))

    def predict(self, run: Record) -> dict[str, Numbers]:
        """The sum of its effects at every row, by the response's column name: µm (N for forces), shape ``(len(run),)``."""
        columns, said = self._inner.predict(run._inner)
        say(said)
        return columns

    def predicted_csv(self, run: Record, *, interval: bool = False) -> str:
        """The record's CSV with ``predicted_…`` columns, as ``rtecctl model predict`` writes it."""
        text, said = self._inner.predicted_csv(run._inner, interval)
        say(said)
        return text

    def half_widths_um(self, run: Record, response: str) -> Numbers | None:
        """Half width of the 95 % interval of a response (``error.y``) at every row, µm; None where no fit states one."""
        return self._inner.half_widths_um(run._inner, response)

    def beyond(self, run: Record) -> Record:
        """The record less what the model predicts of its responses."""
        return Record(self._inner.beyond(run._inner))

    def doubts(self, today: str | None = None) -> list[str]:
        """What to know before it is trusted, on a day (``YYYY-MM-DD``; today where left out)."""
        return self._inner.doubts(today)

    def days_left(self, today: str | None = None) -> int | None:
        """Days until the first of its fits is no longer good; None without fits."""
        return self._inner.days_left(today)


def read_machine(path: Place) -> Machine:
    """Reads a ``machine.toml``, strictly: the first finding raises :class:`InputError`."""
    return Machine(_rtec.Machine.read(os.fspath(path)))


Runs = Record | Place | Iterable[Record | Place]


def _records(runs: Runs) -> list[_rtec.Record]:
    many: Iterable[Record | Place] = [runs] if isinstance(runs, (Record, str, os.PathLike)) else runs
    return [run._inner if isinstance(run, Record) else read_record(run)._inner for run in many]


def _machine(machine: Machine | Place) -> Machine:
    return machine if isinstance(machine, Machine) else read_machine(machine)


def evaluate(
    runs: Runs,
    standard: str | None = None,
    *,
    conditions: Place | None = None,
    one_way: bool = False,
    norm: int = 2,
) -> Evaluation:
    """Evaluates runs as their standard defines it.

    ``standard``: ``iso230-2``, ``straightness``, ``iso230-3``, ``iso230-6``, ``ballbar`` (``iso230-4``), ``plate`` or
    ``repeatability``; by the first record's kind where it is left out. ``conditions``: a file with what the test was done under,
    for uncertainties and the reduction to 20 °C. ``norm``: a plate's fit makes squares (2) or fourth powers (4) small.
    """
    place = None if conditions is None else os.fspath(conditions)
    (document, text, html, pictures), said = _rtec.evaluate(_records(runs), standard, place, one_way, norm)
    return Evaluation(document, pictures, say(said), text, html)


def _asked(
    sensors: Sequence[str],
    environment: str | None,
    folds: int,
    lag: bool,
    square: bool,
    base: Machine | Place | None,
    date: str | None,
    valid_days: int,
    despite_suspicions: bool,
) -> dict[str, Any]:
    return {
        "sensors": list(sensors),
        "environment": environment,
        "folds": folds,
        "lag": lag,
        "square": square,
        "base": None if base is None else _machine(base)._inner,
        "date": date,
        "valid_days": valid_days,
        "despite_suspicions": despite_suspicions,
    }


def select_sensors(
    train: Runs,
    *,
    sensors: Sequence[str] = (),
    environment: str | None = None,
    folds: int = 10,
    lag: bool = True,
    square: bool = True,
    base: Machine | Place | None = None,
) -> Fit:
    """Chooses sensors by correlation (CASC) and rounds of refitting; options as :func:`fit`."""
    asked = _asked(sensors, environment, folds, lag, square, base, "1970-01-01", 365, True)
    (document, machine, pictures), said = _rtec.fit(_records(train), [], asked, True)
    return Fit(document, pictures, say(said), Machine(machine))


def fit(
    train: Runs,
    holdout: Runs = (),
    *,
    sensors: Sequence[str] = (),
    environment: str | None = None,
    folds: int = 10,
    lag: bool = True,
    square: bool = True,
    base: Machine | Place | None = None,
    date: str | None = None,
    valid_days: int = 365,
    despite_suspicions: bool = False,
) -> Fit:
    """Fits growth from temperatures: sensors chosen, blocks of time left out, hold-outs judged.

    ``sensors``: differences to choose from, as ``["T0", "T8-T18"]``; all where it is empty. ``holdout`` never influences the fit.
    ``base``: what is known already. ``date``: the day that the model carries.
    """
    asked = _asked(sensors, environment, folds, lag, square, base, date, valid_days, despite_suspicions)
    (document, machine, pictures), said = _rtec.fit(_records(train), _records(holdout), asked, False)
    return Fit(document, pictures, say(said), Machine(machine))


def fit_effects(
    train: Runs,
    effects: Sequence[str],
    *,
    base: Machine | Place | None = None,
    date: str | None = None,
    valid_days: int = 365,
    despite_suspicions: bool = False,
) -> Fit:
    """Fits effects by name, by least squares: ``["scale.x", "thermal_expansion.x:T3-T20"]``."""
    asked = _asked((), None, 10, True, True, base, date, valid_days, despite_suspicions)
    (document, machine, pictures), said = _rtec.fit_named(_records(train), list(effects), asked)
    return Fit(document, pictures, say(said), Machine(machine))


def reconcile(
    train: Runs,
    machine: Machine | Place,
    holdout: Runs = (),
    *,
    level: float = 0.01,
    unexplained: bool = False,
    date: str | None = None,
    out: Place | None = None,
) -> Verdict:
    """Finds what a model lacks, names it, adds it, and shows how far the gap shrank.

    ``level``: how often chance alone may lead to an answer. ``holdout`` never influences the verdict, only the last figures.
    ``out``: a folder for ``verdict.json``, ``model.toml`` and ``report.html``. ``date``: the day that added effects carry.
    """
    (document, model, html, pictures, laws), said = _rtec.reconcile(
        _records(train), _machine(machine)._inner, _records(holdout), level, unexplained, date
    )
    verdict = Verdict(document, pictures, say(said), Machine(model), html, laws)
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        whole(folder / "verdict.json", document + "\n")
        if laws is not None:
            whole(folder / "unexplained.toml", laws)
        verdict.model.write(folder / "model.toml")
        whole(folder / "report.html", html)
    return verdict


def where_they_disagree(train: Runs, machine: Machine | Place, *, level: float = 0.01) -> Result:
    """The first stage of a reconciliation alone: where measured and simulated disagree."""
    return Result(_rtec.where_they_disagree(_records(train), _machine(machine)._inner, level))


def plan(
    axes: Mapping[str, float],
    *,
    machine: str = "the machine",
    max_rpm: float = 6000.0,
    ballbar_mm: float | None = None,
) -> Plan:
    """The sequence of runs that a machine is characterised with; ``axes``: travel in mm by name."""
    given = [(name, float(travel)) for name, travel in axes.items()]
    (document, markdown), said = _rtec.plan(given, machine, max_rpm, ballbar_mm)
    return Plan(document, markdown, say(said))


def designs(
    computer: str = "8051",
    *,
    encoder_hz: float = 7e6 / 60.0 / 4.0,
    accel_counts_s2: float = 1e6,
    counts: int = 20_000,
    seed: int = 1,
) -> Design:
    """Every design of insertion on the same motion; ``computer``: ``8051`` or ``dsp``."""
    document, text = _rtec.designs(computer, encoder_hz, accel_counts_s2, counts, seed)
    return Design(document, text)


def replay(
    trace: Place,
    requests: Place,
    *,
    design: str | None = None,
    config: Place | None = None,
    axis: str | None = None,
) -> Replay:
    """Plays a recorded trace (``t_ns,a,b``) with requested totals (``t_ns,requested``) through the real-time engine."""
    place = None if config is None else os.fspath(config)
    document, sound = _rtec.replay(os.fspath(trace), os.fspath(requests), design, place, axis)
    return Replay(document, sound)


def part_errors(
    points: Place,
    *,
    radius_mm: float | None = None,
    tip_mm: float | None = None,
    feature: str | None = None,
    taper_deg: float | None = None,
    machine: Place | None = None,
    origin_mm: tuple[float, float] | None = None,
    expected: Place | None = None,
    path: Place | None = None,
    trip_window_mm: float = 1.0,
    with_size: bool = False,
) -> PartErrors:
    """A feature's errors from probed points, a CSV ``z_mm,x_mm[,approach_z,approach_x]``.

    ``radius_mm``: a circle's nominal radius. ``tip_mm``: the probe's. ``feature``: ``circle`` or ``line``; recognised where left
    out. ``machine``: a model whose prediction is taken out, with the machine's position (Z, X) at the part's zero in ``origin_mm``.
    """
    places = {"machine": machine, "expected": expected, "path": path}
    asked: dict[str, Any] = {name: None if p is None else os.fspath(p) for name, p in places.items()}
    asked |= {"points": os.fspath(points), "radius_mm": radius_mm, "tip_mm": tip_mm, "feature": feature}
    asked |= {"taper_deg": taper_deg, "trip_window_mm": trip_window_mm, "with_size": with_size}
    asked["origin_mm"] = None if origin_mm is None else [float(v) for v in origin_mm]
    (document, cor, svg), said = _rtec.part_errors(asked)
    errors = json.loads(document)["errors"]
    around = [[e["angle_rad"], e["error_um"]] for e in errors]
    series = {"label": "error", "points": around, "style": "line", "colour": "up"}
    picture = {"kind": "polar", "title": "Errors of the part", "axes": ["z", "x"], "radius_mm": radius_mm}
    return PartErrors(document, json.dumps([picture | {"series": [series]}]), say(said), cor, svg)


def simulate(
    name: str,
    truth: Machine | Place | None = None,
    known: Machine | Place | None = None,
    *,
    seed: int = 1,
    out: Place = ".",
) -> Simulation:
    """Runs an experiment (``linear-displacement``, ``ballbar``, ``drift`` …) on a simulated machine.

    ``truth``: the machine as it is; ``known``: what the corrector knows of it, for a second run with compensation. Records will stand
    in the folder ``out``; they are not written yet.
    """
    inner = [None if m is None else _machine(m)._inner for m in (truth, known)]
    records, document = _rtec.simulate(name, inner[0], inner[1], seed, os.fspath(out))
    return Simulation(document, [Record(r) for r in records])


def example(name: str, folder: Place) -> list[Path]:
    """Writes an example machine (``lathe``, ``mill``, ``wo97``, ``spindle``) into a new or empty folder; gives its files."""
    at = Path(folder)
    if at.exists() and any(at.iterdir()):
        raise FileExistsError(f"{at}: has something in it; expected a new or empty folder")
    records, files = _rtec.example(name, os.fspath(at))
    written = []
    for run in records:
        Path(run.path).parent.mkdir(parents=True, exist_ok=True)
        written.append(Path(run.write(None).path))
    for path, text in files:
        (at / path).parent.mkdir(parents=True, exist_ok=True)
        whole(at / path, text)
        written.append(at / path)
    return written


def history(
    runs: Runs, machine: str = "the machine", *, limits: Mapping[str, float] | Place | None = None
) -> Evaluation:
    """One machine's figures over time: ``figures`` (``x.A`` … with ``points``, ``limit``, ``trend``), ``left_out``.

    Each record is evaluated by itself; one without a date, or that cannot be read, is named and left out. ``limits``: what the
    figures may be, either side of zero, as ``{"x.A": 12.0, "B_mean": 5.0}``, or a file with a table ``[limits]``.
    """
    many: list[Record | Place] = [runs] if isinstance(runs, (Record, str, os.PathLike)) else list(runs)
    paths = [os.fspath(run) for run in many if not isinstance(run, Record)]
    made = [run._inner for run in many if isinstance(run, Record)]
    named = [(n, float(v)) for n, v in limits.items()] if isinstance(limits, Mapping) else []
    file = None if limits is None or isinstance(limits, Mapping) else os.fspath(limits)
    document, text, html, pictures = _rtec.history(machine, paths, made, named, file)
    return Evaluation(document, pictures, (), text, html)
