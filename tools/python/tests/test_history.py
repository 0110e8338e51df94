"""The history of one machine, by the command and from Python; scipy checks its trend."""

import json

import pytest
from scipy import stats

import rtec
import shop_data as data


def test_the_document_is_the_command_s_and_the_trend_scipy_s(rtecctl, tmp_path):
    base = data.run(1, "2026-05")
    days = ["2026-01-10", "2026-03-02", "2026-05-15", "2026-06-30", "2026-08-11"]
    for i, day in enumerate(days):
        columns = {c: (role, base[c] + (0.004 * i * base["x"] if c == "e" else 0.0)) for c, role, _ in base.columns}
        rtec.record(tmp_path / f"r{i}.run.toml", "positioning", columns, date=day).write()
    (tmp_path / "r9.run.toml").write_text("kind = 3\n")
    limits = tmp_path / "limits.toml"
    limits.write_text('[limits]\n"x.M" = 4.0\nB_mean = 100.0\n')
    paths = sorted(tmp_path.glob("*.run.toml"))
    found = rtec.history(paths, limits=limits)
    page = tmp_path / "history.html"
    done = rtecctl("history", tmp_path, "--limits", limits, "--html", page, "--json", code=1)
    assert found.json == done.stdout.removesuffix("\n")
    assert "x.M" in done.stderr and "r9.run.toml" in done.stderr
    assert found.html == page.read_text() and len(found.plots()) == len(found.document["figures"])
    assert [left["record"] for left in found.document["left_out"]] == [str(paths[-1])]
    figures = {f["name"]: f for f in found.document["figures"]}
    m = figures["x.M"]
    at = [(__import__("datetime").date.fromisoformat(p["date"])).toordinal() for p in m["points"]]
    judged = stats.linregress(at, [p["value"] for p in m["points"]])
    half = stats.t.ppf(0.975, len(at) - 2) * judged.stderr * 365.25
    assert m["trend"]["per_year"] == pytest.approx(judged.slope * 365.25, rel=1e-9)
    assert m["trend"]["interval"] == pytest.approx([judged.slope * 365.25 - half, judged.slope * 365.25 + half], rel=1e-6)
    assert m["trend"]["drifts"] and m["beyond"]
    assert not figures["x.R"]["trend"]["drifts"]
    assert json.loads(rtec.history(paths, limits={"x.M": 4.0, "B_mean": 100.0}).json) == found.document


def test_growth_per_kelvin(spindle):
    runs = [rtec.read_record(p) for p in sorted((spindle / "records").glob("drift*.run.toml"))]
    dated = [
        rtec.record(r.path, r.kind, {c: (role, r[c], unit) for c, role, unit in r.columns}, date=f"2026-0{i + 1}-01")
        for i, r in enumerate(runs)
    ]
    found = {f["name"]: f for f in rtec.history(dated).document["figures"]}
    y = found["y.growth_um_per_K"]
    for run, point in zip(dated, y["points"]):
        judged = stats.linregress(run[y["sensor"]], run["error.y"])
        assert point["value"] == pytest.approx(judged.slope, rel=1e-9)
