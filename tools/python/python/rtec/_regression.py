"""The regression behind a fit or a verdict, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from numpy.typing import NDArray

from rtec._errors import needs

if TYPE_CHECKING:
    import pandas as pd

    from rtec import _rtec

Numbers = NDArray[np.float64]

#: Half width of a 95 % interval in standard deviations.
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True, repr=False)
class Regression:
    """A fit or a verdict, linearised: ``n`` rows, ``p`` fitted values, ``z`` set-up terms.

    ``measured ≈ predicted + set_up @ set_up_values``; a change of the values by ``d`` changes the prediction by ``design @ d``.
    Rows are ordered by response, record and acquisition, without what was left out.
    """

    #: The record's file of each row, shape ``(n,)``.
    record: Any
    #: The response of each row, as ``error.y``, shape ``(n,)``.
    response: Any
    #: The row's number within the used record, from 0, shape ``(n,)``.
    row: Any
    #: Unit of each row: ``um`` or ``N``, shape ``(n,)``.
    unit: Any
    #: Measured values, µm or N, shape ``(n,)``.
    measured: Numbers
    #: The model's prediction without the set-up, µm or N, shape ``(n,)``.
    predicted: Numbers
    #: Derivative of each row by each fitted value, unit of the row per unit of the value, shape ``(n, p)``.
    design: Numbers
    #: Names of the fitted values, as ``reversal.y um``, ``p`` of them.
    names: list[str]
    #: Their units, ``p`` of them.
    units: list[str]
    #: Their values, each in its unit, shape ``(p,)``.
    values: Numbers
    #: Half widths of their stated 95 % intervals, each in its unit, shape ``(p,)``.
    half_widths: Numbers
    #: Columns of the set-up (zeros of gauges, a circle's centre), shape ``(n, z)``.
    set_up: Numbers
    #: Names of the set-up's terms, ``z`` of them.
    set_up_names: list[str]

    def __repr__(self) -> str:
        n, p = self.design.shape
        return f"<rtec.Regression {n} rows, {p} values, {len(self.set_up_names)} set-up terms>"

    @cached_property
    def set_up_values(self) -> Numbers:
        """The set-up terms that fit the model's residuals by least squares, µm or N, shape ``(z,)``."""
        left = self.measured - self.predicted
        return np.asarray(np.linalg.lstsq(self.set_up, left, rcond=None)[0], dtype=np.float64)

    @cached_property
    def residuals(self) -> Numbers:
        """Measured less predicted less set-up, µm or N, shape ``(n,)``."""
        return self.measured - self.predicted - self.set_up @ self.set_up_values

    @cached_property
    def scatter(self) -> Numbers:
        """Standard deviation of the residuals of each row's response, µm or N, shape ``(n,)``.

        Fitted values reduce the degrees of freedom."""
        sizes = np.ones(len(self.measured))
        p = self.design.shape[1]
        for name in np.unique(self.response):
            own = self.response == name
            used = np.linalg.matrix_rank(np.column_stack([self.design, self.set_up])[own]) if p + len(self.set_up_names) else 0
            squares = float(np.sum(self.residuals[own] ** 2))
            sizes[own] = max(np.sqrt(squares / max(int(own.sum()) - int(used), 1)), 1e-12)
        return sizes

    @cached_property
    def white_covariance(self) -> Numbers:
        """Covariance of the fitted values for white noise, (X'WX)⁻¹ with the set-up, shape ``(p, p)``.

        Each response is weighted by its scatter. Directions that the rows do not determine (a map and its zero) have none: the
        pseudo-inverse leaves them out.
        """
        p = self.design.shape[1]
        whole = np.column_stack([self.design, self.set_up]) / self.scatter[:, None]
        size = np.linalg.norm(whole, axis=0)
        size[size == 0.0] = 1.0
        inverse = np.linalg.pinv(whole / size) / size[:, None]
        return np.asarray((inverse @ inverse.T)[:p, :p])

    @cached_property
    def correlation(self) -> Numbers:
        """Correlation of the fitted values from the design, shape ``(p, p)``."""
        size = np.sqrt(np.diag(self.white_covariance))
        size[size == 0.0] = 1.0
        found = self.white_covariance / np.outer(size, size)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

    @cached_property
    def covariance(self) -> Numbers:
        """Covariance of the fitted values in products of their units, shape ``(p, p)``.

        Its diagonal follows from the stated intervals, which allow for more than white noise (blocks left out, rounding,
        correlated noise). Its correlations are those of the design.
        """
        sd = self.half_widths / NORMAL_95
        return np.asarray(self.correlation * np.outer(sd, sd))

    @cached_property
    def band(self) -> Numbers:
        """Half width of the 95 % confidence band of the prediction by the fitted values, µm or N, shape ``(n,)``."""
        variance = np.einsum("ij,jk,ik->i", self.design, self.covariance, self.design)
        return np.asarray(NORMAL_95 * np.sqrt(np.maximum(variance, 0.0)))

    def frame(self) -> pd.DataFrame:
        """Row by row: record, row, response, unit, measured, predicted, residual, band.

        Returns
        -------
        pandas.DataFrame
            ``n`` rows; figures in µm or N, as ``unit`` says.
        """
        columns = ["record", "row", "response", "unit", "measured", "predicted"]
        named = {name: getattr(self, name) for name in columns}
        return _pandas().DataFrame(named | {"residual": self.residuals, "band": self.band})

    def values_frame(self) -> pd.DataFrame:
        """The fitted values with their units and intervals.

        Returns
        -------
        pandas.DataFrame
            ``p`` rows by name: unit, value, low, high.
        """
        low, high = self.values - self.half_widths, self.values + self.half_widths
        named = {"unit": self.units, "value": self.values, "low": low, "high": high}
        return _pandas().DataFrame(named, index=self.names)

    def covariance_frame(self) -> pd.DataFrame:
        """The covariance with its names.

        Returns
        -------
        pandas.DataFrame
            ``p`` rows and columns.
        """
        return _pandas().DataFrame(self.covariance, index=self.names, columns=self.names)

    def design_frame(self) -> pd.DataFrame:
        """Derivatives and set-up columns with their names.

        Returns
        -------
        pandas.DataFrame
            ``n`` rows, ``p + z`` columns.
        """
        return _pandas().DataFrame(np.column_stack([self.design, self.set_up]), columns=self.names + self.set_up_names)


def _pandas() -> Any:
    try:
        import pandas
    except ModuleNotFoundError:
        raise needs("pandas", "frames") from None
    return pandas


def regression(
    records: list[_rtec.Record], base: _rtec.Machine | None, machine: _rtec.Machine, of_verdict: bool
) -> Regression:
    """The arrays for the effects that a machine has in addition to its base."""
    from rtec import _rtec

    return arranged(_rtec.regression(records, base, machine, of_verdict))


def arranged(arrays: _rtec._Arrays) -> Regression:
    """Gives names to the arrays from Rust."""
    rows, measured, predicted, columns = arrays
    counts = [count for *_, count in rows]
    fitted = [c for c in columns if c[3] is not None]
    terms = [c for c in columns if c[3] is None]

    def stacked(of: list[Any]) -> Numbers:
        return np.column_stack([c[5] for c in of]) if of else np.zeros((len(measured), 0))

    return Regression(
        record=np.repeat([r[0] for r in rows], counts),
        response=np.repeat([r[1] for r in rows], counts),
        row=np.concatenate([np.arange(count) for count in counts]),
        unit=np.repeat([r[2] for r in rows], counts),
        measured=measured,
        predicted=predicted,
        design=stacked(fitted),
        names=[f"{c[0]} {c[1]}" for c in fitted],
        units=[c[2] for c in fitted],
        values=np.array([c[3] for c in fitted], dtype=np.float64),
        half_widths=np.array([c[4] for c in fitted], dtype=np.float64),
        set_up=stacked(terms),
        set_up_names=[f"{c[0]} {c[1]}" for c in terms],
    )
