"""Figures of matplotlib: everything that the HTML reports show, one call each."""

from __future__ import annotations

import json
from typing import Any

from matplotlib.figure import Figure

from rtec import _rtec
from rtec._draw import COLOURS, Plot, draw
from rtec._machine import Machine
from rtec._record import Record
from rtec._results import Drawn
from rtec._text import say

__all__ = ["COLOURS", "Plot", "draw", "of", "prediction"]


def of(result: Drawn[Any]) -> list[Figure]:
    """The plots of a result's report: of an evaluation, a fit, a verdict, a part's errors."""
    return [draw(picture) for picture in result.pictures]


def prediction(machine: Machine, run: Record) -> list[Figure]:
    """Measured and predicted over time, one figure per response.

    It has the 95 % interval if a fit states one."""
    text, said = _rtec.prediction_picture(machine._inner, run._inner)
    say(said)
    return [draw(picture) for picture in json.loads(text)]
