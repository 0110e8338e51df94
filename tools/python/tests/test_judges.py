"""numpy and scipy check the libraries' results."""

import numpy as np
import pytest
from scipy import optimize

import rtec


def iso230_2(position, direction, error):
    """ISO 230-2, by its own formulas."""
    # The largest gaps separate the targets; each was approached five times from both sides.
    order = np.argsort(position)
    gaps = np.diff(position[order])
    groups = np.split(order, np.flatnonzero(gaps > 1.0) + 1)
    mean, s = {}, {}
    for name, sign in (("up", 1.0), ("down", -1.0)):
        sides = [error[g][direction[g] == sign] for g in groups]
        mean[name] = np.array([x.mean() for x in sides])
        s[name] = np.array([x.std(ddof=1) for x in sides])
    b = mean["up"] - mean["down"]
    figures = {"B": np.abs(b).max(), "B_mean": b.mean()}
    middle = (mean["up"] + mean["down"]) / 2
    figures["M"] = middle.max() - middle.min()
    high = {n: mean[n] + 2 * s[n] for n in mean}
    low = {n: mean[n] - 2 * s[n] for n in mean}
    for n in mean:
        figures[f"E_{n}"] = np.ptp(mean[n])
        figures[f"R_{n}"] = (4 * s[n]).max()
        figures[f"A_{n}"] = high[n].max() - low[n].min()
    figures["E"] = max(m.max() for m in mean.values()) - min(m.min() for m in mean.values())
    figures["A"] = max(h.max() for h in high.values()) - min(x.min() for x in low.values())
    both = 2 * s["up"] + 2 * s["down"] + np.abs(b)
    figures["R"] = np.maximum.reduce([both, 4 * s["up"], 4 * s["down"]]).max()
    return figures


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_positioning_by_the_standard_s_own_formulas(mill, axis):
    run = rtec.read_record(mill / f"records/linear-displacement-{axis}.run.toml")
    found = rtec.evaluate(run).document
    wanted = iso230_2(run[f"position.{axis}"], run[f"direction.{axis}"], run[f"error.{axis}"])
    for symbol, value in wanted.items():
        assert found[symbol] == pytest.approx(value, rel=1e-9), symbol


def test_a_model_is_the_sum_of_its_laws():
    text = """name = "sum"
[[effect]]
name = "scale.x"
ppm = 12.0
[[effect]]
name = "reversal.x"
um = 6.0
[[effect]]
name = "thermal_growth.x"
sensor = "T1"
um_per_K = 0.5
um_per_K2 = 0.01
[[effect]]
name = "screw_periodic.x"
period_mm = 10.0
um = 2.0
phase_rad = 0.3
"""
    rng = np.random.default_rng(1)
    p, t1 = rng.uniform(-200, 200, 50), rng.uniform(15, 30, 50)
    up = np.where(np.arange(50) % 2 == 0, 1.0, -1.0)
    run = rtec.record(
        "a.run.toml",
        "positioning",
        {
            "x": ("position.x", p),
            "d": ("direction.x", up),
            "T1": ("temperature", t1),
            "e": ("error.x", np.zeros(50)),
        },
    )
    said = rtec.Machine.parse(text).predict(run)["e"]
    growth = 0.5 * (t1 - 20) + 0.01 * (t1 - 20) ** 2
    wanted = 12.0 * p / 1000 + 3.0 * up + growth + 2.0 * np.sin(2 * np.pi * p / 10 + 0.3)
    assert np.allclose(said, wanted, atol=1e-9)
    left = rtec.Machine.parse(text).beyond(run)
    assert np.allclose(left["e"], -wanted, atol=1e-9)


def test_named_effects_are_scipy_s_least_squares():
    rng = np.random.default_rng(7)
    n = 400
    p = rng.uniform(-250, 250, n)
    up = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    e = 3.0 + 17.0 * p / 1000 + 4.5 * up / 2 + rng.normal(0, 0.2, n)
    run = rtec.record(
        "b.run.toml",
        "positioning",
        {"x": ("position.x", p), "d": ("direction.x", up), "e": ("error.x", e)},
        date="2026-05-01",
    )
    found = rtec.fit_effects(run, ["scale.x", "reversal.x"]).document
    judged = optimize.lsq_linear(np.column_stack([np.ones(n), p / 1000, up / 2]), e).x
    values = {f["name"]: f["parameters"] for f in found["effects"]}
    assert values["scale.x"]["ppm"]["value"] == pytest.approx(judged[1], rel=1e-6)
    assert values["reversal.x"]["um"]["value"] == pytest.approx(judged[2], rel=1e-6)


def test_a_circle_is_scipy_s(tmp_path):
    rng = np.random.default_rng(3)
    a = np.linspace(0.1, 1.4, 30)
    z, x = 10.003 * np.cos(a) + rng.normal(0, 3e-4, 30), 10.003 * np.sin(a) + rng.normal(0, 3e-4, 30)
    points = tmp_path / "probed.csv"
    points.write_text("z_mm,x_mm\n" + "".join(f"{p},{q}\n" for p, q in zip(z, x)))
    found = rtec.part_errors(points, radius_mm=10.0, tip_mm=0.0).document
    left = lambda c: np.hypot(z - c[0], x - c[1]) - np.hypot(z - c[0], x - c[1]).mean()  # noqa: E731
    judged = optimize.least_squares(left, [0.0, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert np.allclose(found["plain_centre_mm"], judged, atol=1e-6)
