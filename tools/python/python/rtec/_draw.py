"""Draws plots given as data as figures of matplotlib."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from rtec._documents import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours that colour-blind readers can distinguish (Okabe and Ito), as in the reports.
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#505050"]
_MEANT = {"up": COLOURS[0], "down": COLOURS[1], "grey": COLOURS[6]}


class Plot(Figure):
    """A figure that a notebook displays automatically."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=90)
        return out.getvalue()


def draw(picture: Picture) -> Figure:
    """Draws a plot given as data."""
    if picture["kind"] == "polar":
        return _polar(picture)
    figure = Plot(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(picture["title"])
    if picture["kind"] == "vectors":
        _vectors(axes, picture)
    else:
        _chart(axes, picture)
    return figure


def _points(series: dict[str, Any]) -> tuple[Any, Any]:
    points = np.array(series["points"], dtype=float).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def _colour(series: dict[str, Any], place: int) -> str:
    return _MEANT.get(series["colour"], COLOURS[place % len(COLOURS)])


def _chart(axes: Axes, picture: Picture) -> None:
    names = picture["x_names"]
    for place, series in enumerate(picture["series"]):
        (x, y), colour, label = _points(series), _colour(series, place), series["label"] or None
        match series["style"]:
            case "dots":
                axes.plot(x, y, ".", color=colour, label=label, markersize=4)
            case "bars":
                wide = 0.7 if names else max(np.ptp(x) / 200 if x.size else 0.0, 1e-9)
                axes.bar(x, y, width=wide, color=colour, alpha=0.8, label=label)
            case "band":
                half = x.size // 2
                axes.fill_between(x[:half], y[:half], y[half:], color=colour, alpha=0.2, lw=0, label=label)
            case _:
                axes.plot(x, y, color=colour, label=label)
    for x, name in picture["marks"]:
        axes.axvline(x, color="#00000040")
        axes.annotate(name, (x, 1.0), xycoords=("data", "axes fraction"), va="top", fontsize="small")
    if names:
        axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set(xlabel=picture["x"], ylabel=picture["y"])
    axes.grid(alpha=0.25)
    if any(series["label"] for series in picture["series"]):
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def _polar(picture: Picture) -> Figure:
    figure = Plot(figsize=(6.4, 6.0), layout="constrained")
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_title(picture["title"])
    first, second = (str(axis).upper() for axis in picture["axes"])
    largest = 1e-3
    for place, series in enumerate(picture["series"]):
        angle, um = _points(series)
        largest = max(largest, float(np.nanmax(np.abs(um), initial=0.0)))
        axes.plot(angle, um, color=_colour(series, place), label=series["label"] or None, lw=1.2)
    axes.plot(np.linspace(0.0, 2.0 * np.pi, 361), np.zeros(361), color="#505050", lw=1.0)
    # The zero circle is drawn large, so that deviations inwards remain visible.
    axes.set_rlim(-2.2 * largest, 1.1 * largest)
    axes.set_xticks(np.arange(4) * np.pi / 2, [f"+{first}", f"+{second}", f"−{first}", f"−{second}"])
    axes.set_xlabel("deviation, µm")
    axes.legend(loc="lower left", bbox_to_anchor=(0.95, 0.0), frameon=False)
    return figure


def _vectors(axes: Axes, picture: Picture) -> None:
    at = np.array([place for place, _ in picture["at"]], dtype=float).reshape(-1, 2)
    by = np.array([um for _, um in picture["at"]], dtype=float).reshape(-1, 2)
    axes.plot(at[:, 0], at[:, 1], ".", color=COLOURS[6])
    arrows = axes.quiver(at[:, 0], at[:, 1], by[:, 0], by[:, 1], angles="xy", color=COLOURS[1], width=0.004)
    longest = float(np.hypot(by[:, 0], by[:, 1]).max(initial=0.0))
    axes.quiverkey(arrows, 1.08, 0.9, longest or 1.0, f"{longest:.1f} µm")
    axes.set(xlabel=f"{picture['axes'][0]} (mm)", ylabel=f"{picture['axes'][1]} (mm)")
    axes.set_aspect("equal")
    axes.grid(alpha=0.25)
