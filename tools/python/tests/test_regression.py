"""Residuals, covariance, design and band of fits and verdicts, checked by numpy's least squares."""

import numpy as np
import pytest

import rtec

N = 400


def line(seed=7, noise=0.2):
    rng = np.random.default_rng(seed)
    p = rng.uniform(-250, 250, N)
    up = np.where(rng.random(N) < 0.5, 1.0, -1.0)
    e = 3.0 + 17.0 * p / 1000 + 4.5 * up / 2 + rng.normal(0, noise, N)
    columns = {"x": ("position.x", p), "d": ("direction.x", up), "e": ("error.x", e)}
    return rtec.record("b.run.toml", "positioning", columns, date="2026-05-01"), p, up, e


def test_a_fit_s_arrays_are_numpy_s_least_squares():
    run, p, up, e = line()
    found = rtec.fit_effects(run, ["scale.x", "reversal.x"]).regression
    assert found.names == ["scale.x ppm", "reversal.x um"] and found.units == ["ppm", "um"]
    assert found.design.shape == (N, 2) and found.set_up.shape == (N, 1) and found.covariance.shape == (2, 2)
    assert np.allclose(found.design, np.column_stack([p / 1000, up / 2]), atol=1e-12)
    whole = np.column_stack([found.design, found.set_up])
    beta, squares, *_ = np.linalg.lstsq(whole, e, rcond=None)
    assert np.allclose(found.values, beta[:2], rtol=1e-9)
    assert np.allclose(found.set_up_values, beta[2:], rtol=1e-9)
    assert np.allclose(found.residuals, e - whole @ beta, atol=1e-9)
    white = squares[0] / (N - 3) * np.linalg.inv(whole.T @ whole)[:2, :2]
    assert np.allclose(found.white_covariance, white, rtol=1e-9)
    assert np.allclose(found.correlation[0, 1], white[0, 1] / np.sqrt(white[0, 0] * white[1, 1]), rtol=1e-9)
    assert np.allclose(np.sqrt(np.diag(found.covariance)) * 1.959963984540054, found.half_widths)
    by_hand = [1.959963984540054 * np.sqrt(x @ found.covariance @ x) for x in found.design]
    assert np.allclose(found.band, by_hand)


def test_what_the_base_knows_is_no_fitted_value():
    run, *_ = line()
    base = rtec.Machine.parse('name = "b"\n[[effect]]\nname = "scale.x"\nppm = 17.0\n')
    found = rtec.fit_effects(run, ["reversal.x"], base=base).regression
    assert found.names == ["reversal.x um"]
    assert np.allclose(found.predicted, base.predict(run)["e"] + found.design @ found.values)


def test_a_constant_that_is_fitted_is_no_zero():
    run, _, _, e = line()
    found = rtec.fit_effects(run, ["offset.x", "scale.x", "reversal.x"]).regression
    assert found.set_up.shape == (N, 0) and found.names[0] == "offset.x um"
    assert np.allclose(found.residuals, e - found.design @ found.values, atol=1e-9)


def test_the_band_holds_the_truth_as_often_as_it_says():
    held, rows = 0, 0
    for seed in range(40):
        run, p, up, _ = line(seed)
        found = rtec.fit_effects(run, ["scale.x", "reversal.x"]).regression
        truth = 17.0 * p / 1000 + 4.5 * up / 2
        held += int((np.abs(found.predicted - truth) <= found.band).sum())
        rows += N
    assert 0.90 <= held / rows <= 1.0, held / rows


def test_a_verdict_s_residuals_are_its_report_s(mill):
    run = rtec.read_record(mill / "records/linear-displacement-y.run.toml")
    verdict = rtec.reconcile(run, mill / "machine.toml")
    found = verdict.regression
    after = [p for s in verdict.pictures[0]["series"] if s["label"].startswith("after") for p in s["points"]]
    assert np.allclose(np.sort(found.residuals), np.sort([v for _, v in after]), atol=1e-3)
    stated = {f"{e['name']} {n}": p for e in verdict.effects for n, p in e["parameters"].items() if isinstance(p["value"], float)}
    values = dict(zip(found.names, found.values))
    for name, parameter in stated.items():
        match = [v for n, v in values.items() if n.startswith(name.split(" ")[0]) and n.endswith(name.split(" ")[1])]
        assert match and match[0] == pytest.approx(parameter["value"]), name
    # A small step of a value changes the prediction by its column times the step.
    k = next(i for i, n in enumerate(found.names) if n.endswith(" um"))
    assert found.design.shape[1] == len(found.names) and np.abs(found.design[:, k]).max() > 0


def test_a_circle_s_centre_is_the_set_up_s():
    rng = np.random.default_rng(5)
    a = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    # 30 µrad out of square; the centre is 12 and -7 µm off, the bar 4 µm longer.
    e = 30 * 0.15 * np.sin(a) * np.cos(a) + 12 * np.cos(a) - 7 * np.sin(a) + 4 + rng.normal(0, 0.1, 360)
    columns = {"a": ("angle", a), "e": ("error.r", e)}
    run = rtec.record("b.run.toml", "ballbar", columns, radius_mm=150.0, plane=["x", "y"])
    found = rtec.reconcile(run, rtec.Machine.ideal("m")).regression
    assert found.set_up.shape == (360, 3) and sum(n.startswith("centre") for n in found.set_up_names) == 2
    centre = dict(zip((n.split(" ")[0] + n.split(" ")[1] for n in found.set_up_names), found.set_up_values))
    assert centre["centre,first"] == pytest.approx(12, abs=0.1) and centre["centre,second"] == pytest.approx(-7, abs=0.1)
    assert found.residuals.std() < 0.15


def test_thermal_fits_have_arrays_too(mill):
    runs = [mill / f"records/drift-{n}.run.toml" for n in ("dry", "wet")]
    found = rtec.fit(runs, base=mill / "machine.toml").regression
    assert found.design.shape == (len(found.measured), len(found.names)) and len(found.names) > 0
    assert np.isfinite(found.covariance).all() and (found.band >= 0).all()
    assert set(found.record) == {"drift-dry.csv", "drift-wet.csv"}


def test_frames_name_what_they_hold():
    pd = pytest.importorskip("pandas")
    run, *_ = line()
    found = rtec.fit_effects(run, ["scale.x", "reversal.x"]).regression
    rows = found.frame()
    assert isinstance(rows, pd.DataFrame) and list(rows.columns[-2:]) == ["residual", "band"] and len(rows) == N
    assert list(found.covariance_frame().columns) == found.names
    assert found.values_frame().loc["reversal.x um", "low"] < 4.5 < found.values_frame().loc["reversal.x um", "high"]
    assert list(found.design_frame().columns) == found.names + found.set_up_names
