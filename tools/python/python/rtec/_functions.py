"""The package's functions."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rtec import _documents as doc
from rtec import _rtec
from rtec._alike import documented, place
from rtec._errors import names
from rtec._found import Fit, Simulation, Verdict
from rtec._machine import Machine, a_machine
from rtec._record import Place, Record, Runs, inners
from rtec._regression import arranged
from rtec._results import ChainFit, Design, Evaluation, History, PartErrors, Plan, Replay, Result
from rtec._text import say, whole


@documented
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
    ``repeatability``; without it the first record's kind decides. ``conditions``: a file with the conditions of the test,
    for uncertainties and the reduction to 20 °C. ``norm``: a plate's fit minimises squares (2) or fourth powers (4).

    Parameters
    ----------
    standard : str, optional
        Without it the first record's kind decides.
    conditions : path, optional
        The conditions of the test.
    one_way : bool
        The run went one way, so it shows no reversal.
    norm : int
        Power of a plate's fit, 2 to 4.

    Returns
    -------
    Evaluation
    """
    (document, text, html, pictures), said = _rtec.evaluate(inners(runs), standard, place(conditions), one_way, norm)
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
    if folds < 0 or valid_days < 0:
        raise ValueError(f"found folds {folds}, valid_days {valid_days}, expected neither below 0")
    return {
        "sensors": names("sensors", sensors),
        "environment": environment,
        "folds": folds,
        "lag": lag,
        "square": square,
        "base": None if base is None else a_machine(base)._inner,
        "date": date,
        "valid_days": valid_days,
        "despite_suspicions": despite_suspicions,
    }


def _fitted(made: Any, base: _rtec.Machine | None) -> Fit:
    (document, machine, pictures, used), said = made
    known = None if base is None else Machine(base)
    return Fit(document, pictures, say(said), machine=Machine(machine), _records=[Record(run) for run in used], _base=known)


@documented
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
    """Chooses sensors by correlation (CASC) and rounds of refitting.

    The options are those of :func:`fit`.

    Returns
    -------
    Fit
    """
    asked = _asked(sensors, environment, folds, lag, square, base, "1970-01-01", 365, True)
    return _fitted(_rtec.fit(inners(train), [], asked, True), asked["base"])


@documented
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

    ``sensors``: differences to choose from, as ``["T0", "T8-T18"]``; all if it is empty. ``holdout`` never influences the fit.
    ``base``: a known model, whose effects are kept. ``date``: the model's date.

    Returns
    -------
    Fit
    """
    asked = _asked(sensors, environment, folds, lag, square, base, date, valid_days, despite_suspicions)
    return _fitted(_rtec.fit(inners(train), inners(holdout), asked, False), asked["base"])


@documented
def fit_effects(
    train: Runs,
    effects: Sequence[str],
    *,
    base: Machine | Place | None = None,
    date: str | None = None,
    valid_days: int = 365,
    despite_suspicions: bool = False,
) -> Fit:
    """Fits named effects by least squares: ``["scale.x", "thermal_expansion.x:T3-T20"]``.

    Parameters
    ----------
    effects : sequence of str
        Names, as ``["scale.x", "thermal_expansion.x:T3-T20"]``.

    Returns
    -------
    Fit
    """
    asked = _asked((), None, 10, True, True, base, date, valid_days, despite_suspicions)
    return _fitted(_rtec.fit_named(inners(train), names("effects", effects), asked), asked["base"])


def fit_chain(
    chain: Place,
    components: Sequence[str],
    runs: Sequence[Record | Place | tuple[Record | Place, tuple[float, float, float]]],
) -> ChainFit:
    """Fits components of a kinematic chain to the runs that measure them.

    ``runs``: records, each with the tool's point (x, y, z) in mm that it measured if that is not the chain's. The same path at two
    points distinguishes a rotation from a displacement.

    Parameters
    ----------
    chain : path
        The chain's file.
    components : sequence of str
        The components to fit, as ``["z slide.dx"]``.
    runs : sequence of Record, path, or (run, (x, y, z))
        Records, each with its tool's point in mm if that is not the chain's.

    Returns
    -------
    ChainFit
    """
    given = [run if isinstance(run, tuple) else (run, None) for run in runs]
    points = [None if point is None else [float(v) for v in point] for _, point in given]
    records = inners([run for run, _ in given])
    document, text, pictures, arrays = _rtec.fit_chain(os.fspath(chain), names("components", components), records, points)
    return ChainFit(document, pictures, (), text, regression=arranged(arrays))


@documented
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

    ``level``: the probability that chance alone leads to an answer. ``holdout`` never influences the verdict, only the last figures.
    ``out``: a folder for ``verdict.json``, ``model.toml`` and ``report.html``. ``date``: the date of added effects.

    Parameters
    ----------
    unexplained : bool
        Add a law for structure that no effect explains.
    out : path, optional
        A folder for ``verdict.json``, ``model.toml`` and ``report.html``.

    Returns
    -------
    Verdict
    """
    base = a_machine(machine)
    (document, model, html, pictures, laws, used), said = _rtec.reconcile(
        inners(train), base._inner, inners(holdout), level, unexplained, date
    )
    verdict = Verdict(
        document, pictures, say(said), html, laws, model=Machine(model), _records=[Record(run) for run in used], _base=base
    )
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        whole(folder / "verdict.json", document + "\n")
        if laws is not None:
            whole(folder / "unexplained.toml", laws)
        verdict.model.write(folder / "model.toml")
        whole(folder / "report.html", html)
    return verdict


@documented
def where_they_disagree(train: Runs, machine: Machine | Place, *, level: float = 0.01) -> Result[doc.WhereDocument]:
    """The first stage of a reconciliation alone: where measured and simulated disagree.

    Returns
    -------
    Result
    """
    return Result(_rtec.where_they_disagree(inners(train), a_machine(machine)._inner, level))


def plan(
    axes: Mapping[str, float],
    *,
    machine: str = "the machine",
    max_rpm: float = 6000.0,
    ballbar_mm: float | None = None,
) -> Plan:
    """Plans the sequence of runs that characterises a machine; ``axes``: travel in mm by name.

    Parameters
    ----------
    axes : mapping of str to float
        Travel by axis, mm.
    machine : str
        Its name.
    max_rpm : float
        The spindle's highest speed, 1/min.
    ballbar_mm : float, optional
        The ballbar's length, mm.

    Returns
    -------
    Plan
    """
    given = [(name, float(travel)) for name, travel in axes.items()]
    (document, markdown), said = _rtec.plan(given, machine, max_rpm, ballbar_mm)
    return Plan(document, markdown, say(said))


@documented
def designs(
    computer: str = "8051",
    *,
    encoder_hz: float = 7e6 / 60.0 / 4.0,
    accel_counts_s2: float = 1e6,
    counts: int = 20_000,
    seed: int = 1,
) -> Design:
    """Compares every design of insertion on the same motion; ``computer``: ``8051`` or ``dsp``.

    Parameters
    ----------
    computer : str
        ``8051`` or ``dsp``.
    encoder_hz : float
        Cycles of the encoder per second.
    accel_counts_s2 : float
        Acceleration, counts/s².
    counts : int
        Length of the motion, counts.

    Returns
    -------
    Design
    """
    document, text = _rtec.designs(computer, encoder_hz, accel_counts_s2, counts, seed)
    return Design(document, text)


def _pairs(columns: Mapping[str, str | int] | None) -> list[str]:
    """Columns by name or number in the form of the command line."""
    return [f"{name}={column}" for name, column in (columns or {}).items()]


def replay(
    trace: Place,
    requests: Place,
    *,
    columns: Mapping[str, str | int] | None = None,
    request_columns: Mapping[str, str | int] | None = None,
    design: str = "c",
    config: Place | None = None,
    axis: str | None = None,
) -> Replay:
    """Plays a recorded trace with requested totals through the real-time engine.

    Parameters
    ----------
    trace : path
        CSV ``t_ns,a,b`` or VCD.
    requests : path
        CSV ``t_ns,requested``.
    columns : mapping, optional
        The trace's columns or signals by name or number, as ``{"t_s": 1, "a": "D0", "b": "D1"}``.
    request_columns : mapping, optional
        The requests' columns by name or number, as ``{"t_ns": 1, "requested": 2}``.
    design : str
        ``original``, ``a``, ``b``, ``c`` or ``ecc``.
    config : path, optional
        An ``rtec.toml``.
    axis : str, optional
        The axis of the configuration.

    Returns
    -------
    Replay
    """
    named = _pairs(columns), _pairs(request_columns)
    document, sound = _rtec.replay(os.fspath(trace), os.fspath(requests), named, design, place(config), axis)
    return Replay(document, sound)


@documented
def part_errors(
    points: Place,
    *,
    columns: Mapping[str, str | int] | None = None,
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
    """Computes a feature's errors from probed points.

    ``columns``: the file's columns by name or number, as ``{"z_mm": 3, "x_mm": "Radius"}``, if it has other names.
    ``radius_mm``: a circle's nominal radius. ``tip_mm``: the radius of the probe's tip. ``feature``: ``circle`` or ``line``; recognised
    if left out. ``machine``: a model whose prediction is subtracted; ``origin_mm`` is the machine's position (Z, X) at the part's zero.

    Parameters
    ----------
    points : path
        CSV ``z_mm,x_mm[,approach_z,approach_x]``.
    columns : mapping, optional
        The file's columns by name or number.
    tip_mm : float, optional
        Radius of the probe's tip, mm.
    feature : str, optional
        ``circle`` or ``line``; recognised if left out.
    taper_deg : float, optional
        A line's nominal inclination, degrees.
    machine : path, optional
        A model whose prediction is subtracted.
    origin_mm : pair of float, optional
        The machine's position (Z, X) at the part's zero, mm.
    expected : path, optional
        The expected points.
    path : path, optional
        The probing path.
    trip_window_mm : float
        Largest distance of a trip from its expected place, mm.
    with_size : bool
        Correct the size as well as the form.

    Returns
    -------
    PartErrors
    """
    places = {"machine": machine, "expected": expected, "path": path}
    asked: dict[str, Any] = {name: place(p) for name, p in places.items()}
    asked |= {"points": os.fspath(points), "radius_mm": radius_mm, "tip_mm": tip_mm, "feature": feature}
    asked |= {"taper_deg": taper_deg, "trip_window_mm": trip_window_mm, "with_size": with_size}
    asked["columns"] = _pairs(columns)
    asked["origin_mm"] = None if origin_mm is None else [float(v) for v in origin_mm]
    (document, cor, svg), said = _rtec.part_errors(asked)
    errors = json.loads(document)["errors"]
    around = [[e["angle_rad"], e["error_um"]] for e in errors]
    series = {"label": "error", "points": around, "style": "line", "colour": "up"}
    picture = {"kind": "polar", "title": "Errors of the part", "axes": ["z", "x"], "radius_mm": radius_mm}
    return PartErrors(document, json.dumps([picture | {"series": [series]}]), say(said), cor, svg)


@documented
def simulate(
    name: str,
    truth: Machine | Place | None = None,
    known: Machine | Place | None = None,
    *,
    seed: int = 1,
    out: Place = ".",
) -> Simulation:
    """Runs an experiment (``linear-displacement``, ``ballbar``, ``drift`` …) on a simulated machine.

    ``truth``: the true machine; ``known``: the corrector's model of it, for a second run with compensation. The records belong in the
    folder ``out``; they are not yet written.

    Parameters
    ----------
    name : str
        The experiment.
    truth : Machine or path, optional
        The true machine.
    known : Machine or path, optional
        The corrector's model of it.

    Returns
    -------
    Simulation
    """
    inner = [None if m is None else a_machine(m)._inner for m in (truth, known)]
    records, document = _rtec.simulate(name, inner[0], inner[1], seed, os.fspath(out))
    return Simulation(document, [Record(r) for r in records])


def example(name: str, folder: Place) -> list[Path]:
    """Writes an example machine into a new or empty folder.

    Parameters
    ----------
    name : str
        ``lathe``, ``mill``, ``wo97`` or ``spindle``.
    folder : path
        A new or empty folder.

    Returns
    -------
    list of pathlib.Path
        The files.
    """
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


@documented
def history(
    runs: Runs, machine: str = "the machine", *, limits: Mapping[str, float] | Place | None = None
) -> History:
    """One machine's figures over time.

    The document has ``figures`` (``x.A`` … with ``points``, ``limit``, ``trend``) and ``left_out``. Each record is evaluated by itself;
    one without a date, or that cannot be read, is named and left out. ``limits``: largest absolute values of the figures, as
    ``{"x.A": 12.0, "B_mean": 5.0}``, or a file with a table ``[limits]``.

    Parameters
    ----------
    machine : str
        Its name.
    limits : mapping or path, optional
        Largest absolute values of the figures.

    Returns
    -------
    History
    """
    many: list[Record | Place] = [runs] if isinstance(runs, (Record, str, os.PathLike)) else list(runs)
    paths = [os.fspath(run) for run in many if not isinstance(run, Record)]
    made = [run._inner for run in many if isinstance(run, Record)]
    named = [(n, float(v)) for n, v in limits.items()] if isinstance(limits, Mapping) else []
    file = None if limits is None or isinstance(limits, Mapping) else os.fspath(limits)
    document, text, html, pictures = _rtec.history(machine, paths, made, named, file)
    return History(document, pictures, (), text, html)
