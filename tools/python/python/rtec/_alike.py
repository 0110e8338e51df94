"""Descriptions of parameters that several functions share, each written once."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

ALIKE = {
    "base": ("Machine or path, optional", "What is known of the machine already."),
    "date": ("str, optional", "The day that the result carries, ``YYYY-MM-DD``; today where left out."),
    "despite_suspicions": ("bool", "Fit although the records show mistakes."),
    "environment": ("str, optional", "The sensor of the air, which no difference is taken of."),
    "folds": ("int", "Blocks of time that are left out in turn."),
    "form": ('path, optional', "A description of a format of one's own."),
    "format": ('str', "The name of the file's format."),
    "holdout": ("Record, path, or iterable of these", "Records that never influence the answer, only the last figures."),
    "kind": ("str", "``positioning``, ``drift``, ``ballbar``, ``plate``, ``dynamics``, ``probing``, ``feed_sweep`` or ``part``."),
    "lag": ("bool", "Offer temperatures behind a lag too."),
    "level": ("float", "How often chance alone may lead to an answer, 0 to 0.5."),
    "log": ("bool", "The record need not have a response."),
    "machine": ("Machine or path", "The model."),
    "out": ("path", "Where the result will be."),
    "path": ("path", "Where it is, or will be."),
    "plane": ('pair of str, optional', "A ballbar's axes: angles go from the first towards the second."),
    "radius_mm": ('float, optional', "A circle's nominal radius; a ballbar's length, mm."),
    "run": ("Record", "Rows are those of the answer."),
    "runs": ("Record, path, or iterable of these", "The records."),
    "seed": ("int", "The same seed gives the same answer."),
    "sensors": ('sequence of str', 'Differences to choose from, as ``["T0", "T8-T18"]``; all where it is empty.'),
    "square": ("bool", "Offer squares of differences too."),
    "today": ("str, optional", "A day, ``YYYY-MM-DD``; today where left out."),
    "train": ("Record, path, or iterable of these", "The records that decide."),
    "unit": ("str", "``mm`` or ``inch``: the unit of positions."),
    "valid_days": ("int", "How long the fit is good."),
}


def documented(function: F) -> F:
    """Adds to a docstring the parameters that it leaves to :data:`ALIKE`, in the signature's order."""
    head, _, rest = inspect.cleandoc(function.__doc__ or "").partition("\n\nParameters\n----------\n")
    own, returns, result = (rest or head).partition("\n\nReturns\n")
    if not rest:
        head, own = own, ""
    said = {m[1]: m[0] for m in re.finditer(r"^(\w+) : .+\n    .+$", own, re.MULTILINE)}
    wanted = [name for name in inspect.signature(function).parameters if name != "self"]
    lines = [said.get(name) or "{} : {}\n    {}".format(name, *ALIKE[name]) for name in wanted]
    function.__doc__ = head + "\n\nParameters\n----------\n" + "\n".join(lines) + returns + result
    return function


def place(path: str | os.PathLike[str] | None) -> str | None:
    """A path as text; None without a path."""
    return None if path is None else os.fspath(path)
