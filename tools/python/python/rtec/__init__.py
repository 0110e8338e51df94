"""The real-time error corrector's libraries: records, models, evaluations, verdicts.

Names end with units: ``_um`` micrometres, ``_mm`` millimetres, ``_s`` seconds, ``_degC``. Arrays are ``float64``, one value per row.

========================================  ==========================================================
run records                               :func:`read_record`, :func:`record`, :class:`Record`
other tools' files                        :func:`import_record`
machine models                            :func:`read_machine`, :class:`Machine`
figures after ISO 230                     :func:`evaluate`
sensors chosen, growth fitted             :func:`select_sensors`, :func:`fit`, :func:`fit_effects`
a kinematic chain fitted                  :func:`fit_chain`
a model judged; a controller's table      :meth:`Machine.validate`, :meth:`Machine.export`
what a model lacks                        :func:`reconcile`, :func:`where_they_disagree`
one machine's figures over time           :func:`history`
a plan of runs, designs of insertion      :func:`plan`, :func:`designs`
a recorded trace through the engine       :func:`replay`
a part's errors                           :func:`part_errors`
how far a long call is                    :func:`progress`
residuals, covariance, band as arrays     :class:`Regression`
simulated machines                        :func:`simulate`, :func:`example`
figures                                   :mod:`rtec.plots`
a shop of many machines                   :mod:`rtec.shop`
========================================  ==========================================================

Every result has ``json``, the text that ``rtecctl … --json`` prints for the same input, byte for byte. It also has ``document``, the
same as Python's own dictionaries and lists. Messages of the program are Python warnings (:class:`InputWarning`) and are kept in ``said``.
Bad input raises :class:`InputError`, a ``ValueError`` with file and line. A missing file raises :class:`MissingFileError`, which is a
``FileNotFoundError`` too. All are :class:`RtecError`.
"""

from rtec._rtec import __version__
from rtec._documents import Picture
from rtec._errors import Bug, InputError, MissingFileError, RtecError
from rtec._found import Fit, Simulation, Verdict
from rtec._progress import Progress, progress
from rtec._record import Record, import_record, read_record, record
from rtec._regression import Regression
from rtec._results import ChainFit, Design, Evaluation, History, PartErrors, Plan, Replay, Result, Table, Validation
from rtec._text import InputWarning
from rtec._machine import Machine, read_machine
from rtec._functions import (
    designs,
    evaluate,
    example,
    fit,
    fit_chain,
    fit_effects,
    history,
    part_errors,
    plan,
    reconcile,
    replay,
    select_sensors,
    simulate,
    where_they_disagree,
)

__all__ = [
    "__version__",
    "Bug",
    "ChainFit",
    "Design",
    "Evaluation",
    "Fit",
    "History",
    "InputError",
    "InputWarning",
    "Machine",
    "MissingFileError",
    "PartErrors",
    "Picture",
    "Plan",
    "Progress",
    "Record",
    "Regression",
    "Replay",
    "Result",
    "RtecError",
    "Simulation",
    "Table",
    "Validation",
    "Verdict",
    "designs",
    "evaluate",
    "example",
    "fit",
    "fit_chain",
    "fit_effects",
    "history",
    "import_record",
    "part_errors",
    "plan",
    "progress",
    "read_machine",
    "read_record",
    "reconcile",
    "record",
    "replay",
    "select_sensors",
    "simulate",
    "where_they_disagree",
]
