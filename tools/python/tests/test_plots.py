"""Figures are compared with those of `tests/baseline`; `RTEC_BASELINE=write` draws them again."""

import os
from pathlib import Path

import pytest

import rtec
from rtec import plots

compare = pytest.importorskip("matplotlib.testing.compare")
BASELINE = Path(__file__).parent / "baseline"
#: Allowed RMS of the grey levels: other versions of matplotlib and its fonts differ by less, another curve by more.
TOLERANCE = 12.0


def same(figure, name, tmp_path):
    import matplotlib
    import matplotlib.style

    with matplotlib.style.context("default"):
        matplotlib.rcParams["font.family"] = "DejaVu Sans"
        actual, expected = tmp_path / f"{name}.png", BASELINE / f"{name}.png"
        figure.savefig(actual, dpi=50)
    if os.environ.get("RTEC_BASELINE") == "write":
        BASELINE.mkdir(exist_ok=True)
        expected.write_bytes(actual.read_bytes())
    found = compare.compare_images(str(expected), str(actual), TOLERANCE)
    assert found is None, found


EVALUATED = {
    "positioning": ("records/linear-displacement-y.run.toml", None),
    "drift": ("records/drift-dry.run.toml", None),
    "plate": ("records/plate.run.toml", None),
}


@pytest.mark.parametrize("name", EVALUATED)
def test_evaluations(mill, name, tmp_path):
    file, standard = EVALUATED[name]
    found = rtec.evaluate(mill / file, standard)
    figures = found.plots()
    assert len(figures) == len(found.pictures) == found.html.count("<figure>")
    for i, figure in enumerate(figures):
        same(figure, f"{name}-{i}", tmp_path)


def test_circles(mill, tmp_path):
    found = rtec.evaluate(sorted((mill / "records").glob("ballbar-xy*.run.toml")))
    assert {p["kind"] for p in found.pictures} == {"polar"}
    same(found.plots()[0], "circle", tmp_path)


def test_a_verdict(lathe, tmp_path):
    verdict = rtec.reconcile(lathe / "records/linear-displacement-z.run.toml", lathe / "machine.toml")
    figures = verdict.plots()
    assert len(figures) == len(verdict.pictures) >= 3
    same(figures[0], "verdict-before-and-after", tmp_path)
    same(figures[-1], "verdict-tried", tmp_path)


def test_sensors_and_a_prediction(spindle, tmp_path):
    fitted = rtec.fit(sorted((spindle / "records").glob("*.run.toml")), base=spindle / "machine.toml")
    same(fitted.plots()[-1], "sensors", tmp_path)
    later = rtec.read_record(sorted((spindle / "holdout").glob("*.run.toml"))[0])
    same(plots.prediction(fitted.machine, later)[-1], "prediction", tmp_path)


def test_a_part(tmp_path):
    points = tmp_path / "probed.csv"
    rows = ["0.0,10.001", "3.826834,9.238795", "7.071068,7.073068", "9.238795,3.826834", "10.002,0.0"]
    points.write_text("z_mm,x_mm\n" + "\n".join(rows) + "\n")
    same(rtec.part_errors(points, radius_mm=10.0).plots()[0], "part", tmp_path)


def test_another_curve_is_seen(mill, tmp_path):
    """Checks that the comparison can fail: the same plot of another axis is another picture."""
    figure = rtec.evaluate(mill / "records/linear-displacement-x.run.toml").plots()[0]
    figure.savefig(tmp_path / "other.png", dpi=50)
    found = compare.compare_images(str(BASELINE / "positioning-0.png"), str(tmp_path / "other.png"), TOLERANCE)
    assert found is not None
