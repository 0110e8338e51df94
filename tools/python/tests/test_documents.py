"""Documents equal those of the command line, byte for byte."""

import filecmp
import json
import warnings

import numpy as np
import pytest

import rtec


def printed(done):
    return done.stdout.removesuffix("\n")


@pytest.mark.parametrize("machine", ["lathe", "mill"])
def test_every_record_of_an_example_is_evaluated_alike(machine, request, rtecctl):
    folder = request.getfixturevalue(machine)
    seen = set()
    for sidecar in sorted((folder / "records").glob("*.run.toml")):
        run = rtec.read_record(sidecar)
        if run.kind in ("dynamics", "probing", "feed_sweep", "part"):
            continue
        seen.add(run.kind)
        found = rtec.evaluate(run)
        assert found.json == printed(rtecctl("characterise", "evaluate", sidecar, "--json")), sidecar
        assert found.text == rtecctl("characterise", "evaluate", sidecar).stdout
        page = folder / "page.html"
        done = rtecctl("characterise", "evaluate", sidecar, "--html", page)
        assert found.html == page.read_text(encoding="utf-8")
        assert "".join(f"{line}\n" for line in found.said) == done.stderr
        assert len(found.pictures) == found.html.count("<figure>") > 0
    assert seen >= {"positioning", "drift", "ballbar"}


def test_all_circles_together_and_conditions(mill, rtecctl, tmp_path):
    circles = sorted((mill / "records").glob("ballbar*.run.toml"))
    assert len(circles) > 1
    found = rtec.evaluate(circles, "iso230-4")
    assert found.json == printed(
        rtecctl("characterise", "evaluate", *circles, "--standard", "iso230-4", "--json")
    )
    conditions = tmp_path / "conditions.toml"
    conditions.write_text('machine = "mill"\n[uncertainty]\ndevice_um = 0.2\ndevice_um_per_m = 0.5\n')
    run = mill / "records/linear-displacement-y.run.toml"
    found = rtec.evaluate(run, conditions=conditions)
    shown = rtecctl("characterise", "evaluate", run, "--conditions", conditions, "--json")
    assert found.json == printed(shown)
    assert found.document["uncertainty"]


def test_sensors_and_fit(spindle, rtecctl, tmp_path):
    train = sorted((spindle / "records").glob("*.run.toml"))
    later = sorted((spindle / "holdout").glob("*.run.toml"))
    known = spindle / "machine.toml"
    records = [a for path in train for a in ("--record", path)]
    chosen = rtec.select_sensors(train, base=known)
    assert chosen.json == printed(rtecctl("model", "select-sensors", *records, "--base", known, "--json"))
    fitted = rtec.fit(train, later, base=known, date="2026-05-01")
    held = [a for path in later for a in ("--holdout", path)]
    out = tmp_path / "cli.toml"
    done = rtecctl(
        "model", "fit", *records, *held, "--base", known, "--date", "2026-05-01", "--out", out, "--json"
    )
    assert fitted.json == printed(done)
    fitted.machine.write(tmp_path / "python.toml")
    assert filecmp.cmp(out, tmp_path / "python.toml", shallow=False)
    assert "".join(f"{line}\n" for line in fitted.said) == done.stderr
    model = rtec.read_machine(out)
    assert model.json == printed(rtecctl("model", "show", "--machine", out, "--json"))
    for interval in (False, True):
        predicted = tmp_path / "predicted.csv"
        more = ["--interval"] if interval else []
        rtecctl("model", "predict", "--machine", out, "--record", later[0], "--out", predicted, *more)
        text = model.predicted_csv(rtec.read_record(later[0]), interval=interval)
        assert text == predicted.read_bytes().decode()


def test_named_effects(mill, rtecctl, tmp_path):
    run, known = mill / "records/linear-displacement-y.run.toml", mill / "machine.toml"
    out = tmp_path / "cli.toml"
    arguments = ["--base", known, "--effects", "offset.y", "--date", "2026-05-01", "--out", out, "--json"]
    done = rtecctl("model", "fit", "--record", run, *arguments)
    fitted = rtec.fit_effects(run, ["offset.y"], base=known, date="2026-05-01")
    assert fitted.json == printed(done)
    fitted.machine.write(tmp_path / "python.toml")
    assert filecmp.cmp(out, tmp_path / "python.toml", shallow=False)


def test_a_verdict_and_its_files(lathe, rtecctl, tmp_path):
    train, later = (lathe / folder / "linear-displacement-z.run.toml" for folder in ("records", "holdout"))
    known = lathe / "machine.toml"
    theirs, ours = tmp_path / "theirs", tmp_path / "ours"
    done = rtecctl("reconcile", train, "--model", known, "--holdout", later, "--out", theirs, "--json")
    verdict = rtec.reconcile(train, known, later, out=ours)
    assert verdict.json == printed(done)
    assert verdict.verdict == "named"
    assert [e["name"] for e in verdict.effects][:1] == ["reversal.z"]
    for name in ("verdict.json", "model.toml", "report.html"):
        assert filecmp.cmp(theirs / name, ours / name, shallow=False), name
    assert "".join(f"{line}\n" for line in verdict.said) == "".join(
        line + "\n" for line in done.stderr.splitlines() if not line.startswith("reconciling ")
    )
    stage = rtecctl("reconcile", train, "--model", known, "--stage", "find", "--json")
    assert rtec.where_they_disagree(train, known).json == printed(stage)


def test_plan_designs_replay_part(rtecctl, tmp_path):
    done = rtecctl("characterise", "plan", "--axes", "x=500,y=400.5", "--json")
    assert rtec.plan({"x": 500, "y": 400.5}).json == printed(done)
    assert rtec.designs(counts=2000, seed=7).json == printed(
        rtecctl("designs", "--counts", 2000, "--seed", 7, "--json")
    )
    trace, requests = tmp_path / "in.csv", tmp_path / "requests.csv"
    states = ["0,0", "1,0", "1,1", "0,1"]
    rows = [f"{i * 20_000},{states[i % 4]}" for i in range(400)]
    trace.write_text("t_ns,a,b\n" + "\n".join(rows) + "\n")
    requests.write_text("t_ns,requested\n1000000,6\n")
    played = rtec.replay(trace, requests, design="c")
    shown = rtecctl("replay", "--trace", trace, "--requests", requests, "--design", "c", "--json")
    assert played.json == printed(shown)
    assert played.sound and played.document["completed"] == 6
    table = [row.replace(",", ";") for row in ["Zeit,D0,D1", *rows]]
    trace.write_text("\n".join(table) + "\n")
    requests.write_text("1000000,6\n")
    columns, totals = {"t_ns": "Zeit", "a": 2, "b": "D1"}, {"t_ns": 1, "requested": 2}
    again = rtec.replay(trace, requests, columns=columns, request_columns=totals, design="c")
    assert again.json == played.json
    points = tmp_path / "probed.csv"
    rows = ["0.0,10.001", "3.826834,9.238795", "7.071068,7.071068", "9.238795,3.826834", "10.002,0.0"]
    points.write_text("z_mm,x_mm\n" + "\n".join(rows) + "\n")
    found = rtec.part_errors(points, radius_mm=10.0)
    done = rtecctl("part", "errors", "--points", points, "--radius-mm", 10, "--json")
    assert found.json == printed(done)
    out = tmp_path / "part"
    rtecctl("part", "errors", "--points", points, "--radius-mm", 10, "--out", out)
    assert found.error_cor == (out / "error.cor").read_text()
    assert found.whisker_svg == (out / "whisker.svg").read_text()


def test_a_simulated_machine(lathe, rtecctl, tmp_path):
    truth = tmp_path / "true.toml"
    truth.write_text('name = "one"\n[[effect]]\nname = "scale.x"\nppm = 20.0\n')
    out = tmp_path / "cli"
    arguments = ["--machine", truth, "--seed", 3, "--out", out, "--json"]
    shown = json.loads(rtecctl("simulate", "linear-displacement", *arguments).stdout)
    ours = tmp_path / "python"
    ours.mkdir()
    found = rtec.simulate("linear-displacement", truth, truth, seed=3, out=ours)
    assert found.document == shown["summary"]
    names = set()
    for run in found.records:
        written = run.write()
        names.add(written.file)
        assert filecmp.cmp(ours / written.file, out / written.file, shallow=False), written.file
    assert names == {p.name for p in out.glob("*.csv")}


def test_the_example_is_the_command_s(lathe, tmp_path):
    files = rtec.example("lathe", tmp_path / "lathe")
    theirs = sorted(p.relative_to(lathe) for p in lathe.rglob("*") if p.is_file() and p.name != "page.html")
    assert sorted(p.relative_to(tmp_path / "lathe") for p in (tmp_path / "lathe").rglob("*") if p.is_file()) == theirs
    assert len(files) <= len(theirs)
    for name in theirs:
        assert filecmp.cmp(lathe / name, tmp_path / "lathe" / name, shallow=False), name
    with pytest.raises(FileExistsError):
        rtec.example("lathe", tmp_path / "lathe")


def test_a_model_is_judged_alike(spindle, mill, rtecctl, tmp_path):
    for folder, code in ((spindle, 0), (mill, 1)):
        later = sorted((folder / "holdout").glob("*.run.toml"))
        records = [a for path in later for a in ("--record", path)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rtec.InputWarning)
            judged = rtec.read_machine(folder / "machine.toml").validate(later)
        code = 1 if judged.no_better else 0
        done = rtecctl(
            "model", "validate", "--machine", folder / "machine.toml", *records, "--json", code=code
        )
        assert judged.json == printed(done)
        told = [line.replace("rtecctl: ", "note: ", 1) for line in done.stderr.splitlines()]
        assert list(judged.said) == told[: len(judged.said)] and len(told) - len(judged.said) == code
        assert len(judged.plots()) == len(judged.document["responses"]) > 0
    with pytest.raises(rtec.InputError, match="no record"):
        rtec.Machine.ideal("m").validate([])


@pytest.mark.parametrize(
    ("form", "given", "flags"),
    [
        ("linuxcnc", {}, []),
        ("linuxcnc-type1", {"unit": "inch", "step_mm": 25.0}, ["--unit", "inch", "--step", "25"]),
        ("csv", {"limit_um": 0.2}, ["--limit-um", "0.2"]),
        ("ssfk", {"axis_number": 2}, ["--axis-number", "2"]),
        ("siemens", {"axis_name": "Y1", "reference_mm": 0.0}, ["--axis-name", "Y1", "--reference-mm", "0"]),
    ],
)
def test_a_controllers_table_is_exported_alike(mill, rtecctl, tmp_path, form, given, flags):
    out, model = tmp_path / "cli.comp", mill / "machine.toml"
    place = ["--axis", "y", "--from", "0", "--to", "400", "--format", form, "--out", out]
    done = rtecctl("model", "export", "--machine", model, *place, *flags, "--json")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rtec.InputWarning)
        table = rtec.read_machine(model).export("y", 0, 400, format=form, **given)
    assert table.json == printed(done)
    table.write(tmp_path / "python.comp")
    assert filecmp.cmp(out, tmp_path / "python.comp", shallow=False)
    told = [line if line.startswith("warning: ") else f"note: {line}" for line in done.stderr.splitlines()]
    assert [line.replace(f"{out}: ", "") for line in told] == list(table.said)


def test_what_a_format_needs_is_said(mill):
    model = rtec.read_machine(mill / "machine.toml")
    for form, option in (("ssfk", "axis-number"), ("siemens", "axis-name"), ("own", "form")):
        with pytest.raises(rtec.InputError, match=f"no {option.replace('-', '_')}"):
            model.export("y", 0, 400, format=form)
    with pytest.raises(rtec.InputError, match="one of linuxcnc"):
        model.export("y", 0, 400, format="fanuc")
    with pytest.raises(rtec.InputError, match="axis"):
        model.export("q", 0, 400)


def test_another_tools_file_is_imported_alike(rtecctl, tmp_path):
    table = tmp_path / "gauge.csv"
    table.write_text("Zeit;z1;T 1\n0;0,0012;20,1\n1;0,0014;20,2\n2;0,0011;20,4\n3;0,0019;20,3\n", encoding="utf-8")
    columns = {"Zeit": "time:min", "z1": "error.z:mm", "T 1": "temperature"}
    flags = ["--columns", ",".join(f"{n}={r}" for n, r in columns.items()), "--decimal", "comma"]
    out = tmp_path / "cli" / "gauge.run.toml"
    out.parent.mkdir()
    done = rtecctl("characterise", "import", table, "--format", "csv", *flags, "--out", out)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = rtec.import_record(table, "csv", tmp_path / "gauge-py.run.toml", columns=columns, decimal="comma")
    assert run["z1"].tolist() == [1.2, 1.4, 1.1, 1.9] and run.time_s.tolist() == [0.0, 60.0, 120.0, 180.0]
    written = run.write(out.with_name("python.run.toml"))
    assert filecmp.cmp(out.with_name("gauge.csv"), out.with_name(written.file), shallow=False)
    assert out.read_text().replace("gauge.csv", "python.csv") == out.with_name("python.run.toml").read_text()
    assert len(seen) == done.stderr.count("warning: ")
    with pytest.raises(rtec.InputError, match="no columns"):
        rtec.import_record(table, "csv", tmp_path / "x.run.toml")
    with pytest.raises(rtec.InputError) as bad:
        rtec.import_record(table, "csv", tmp_path / "x.run.toml", columns={"Zeit": "time", "z9": "error.z"})
    assert bad.value.file == str(table) and "z9" in str(bad.value)
    with pytest.raises(ValueError, match="comma"):
        rtec.import_record(table, "csv", tmp_path / "x.run.toml", columns=columns, decimal=",")


CHAIN = """tool_mm = [0.0, 0.0, 0.0] # the gauge line
[[joint]]
name = "x slide"
branch = "tool"
axis = "x"
component = [{ of = "dx", terms = [{ p = 1, value = 0.0 }] }, { of = "ey", terms = [{ p = 1, value = 0.0 }] }]
"""


def test_a_chain_is_fitted_alike(rtecctl, tmp_path):
    chain = tmp_path / "chain.toml"
    chain.write_text(CHAIN)
    rng = np.random.default_rng(4)
    x = np.linspace(0.0, 400.0, 41)
    # dx = 2 µm and ey = 5 µrad per 100 mm, seen at two heights of the tool.
    points = [(0.0, 0.0, 0.0), (0.0, 0.0, -300.0)]
    runs = []
    for n, (_, _, z) in enumerate(points):
        e = 2.0 * x / 100.0 + 5.0 * x / 100.0 * z / 1000.0 + rng.normal(0, 0.05, x.size)
        columns = {"x": ("position.x", x), "e": ("error.x", e)}
        runs.append(rtec.record(tmp_path / f"r{n}.run.toml", "positioning", columns).write())
    parts = ["x slide.dx", "x slide.ey"]
    fitted = rtec.fit_chain(chain, parts, list(zip(runs, points)))
    records = [a for run, p in zip(runs, points) for a in ("--record", f"{run.path}@{','.join(map(str, p))}")]
    out = tmp_path / "cli.toml"
    flags = ["--component", ",".join(parts), *records, "--out", out, "--json"]
    assert fitted.json == printed(rtecctl("model", "fit-chain", "--chain", chain, *flags))
    fitted.write(tmp_path / "python.toml")
    assert filecmp.cmp(out, tmp_path / "python.toml", shallow=False) and "# the gauge line" in fitted.text
    values = [term["value"] for term in fitted.document["terms"]]
    # Least squares of the same two columns by numpy.
    lever = np.concatenate([np.full(x.size, z / 1000.0) for _, _, z in points])
    both = np.tile(x, 2) / 100.0
    measured = np.concatenate([run["e"] for run in runs])
    free = np.column_stack([both, both * lever, *(np.repeat(np.eye(2), x.size, axis=0).T)])
    assert np.allclose(values, np.linalg.lstsq(free, measured, rcond=None)[0][:2], rtol=1e-6)
    assert len(fitted.plots()) == 2
    # The arrays behind the fit.
    found = fitted.regression
    assert found.names == ["x slide.dx p1 dT0", "x slide.ey p1 dT0"] and found.units == ["um", "urad"]
    assert set(found.record) == {run.file for run in runs} and set(found.response) == {"error.x"}
    # The chain includes products of two small quantities, the columns by hand do not.
    assert np.allclose(found.design, free[:, :2], atol=1e-4) and np.allclose(found.set_up, free[:, 2:])
    beta, squares, *_ = np.linalg.lstsq(free, measured, rcond=None)
    assert np.allclose(found.residuals, measured - free @ beta, atol=3e-4)
    white = squares[0] / (measured.size - 4) * np.linalg.inv(free.T @ free)[:2, :2]
    assert np.allclose(found.white_covariance, white, rtol=1e-2)
    by_hand = [1.959963984540054 * np.sqrt(row @ found.covariance @ row) for row in found.design]
    assert np.allclose(found.band, by_hand)
    stated = np.array([term["interval"] for term in fitted.document["terms"]])
    assert np.allclose(2 * found.half_widths, stated[:, 1] - stated[:, 0])
    pd = pytest.importorskip("pandas")
    assert isinstance(found.frame(), pd.DataFrame) and list(found.covariance_frame().columns) == found.names
    with pytest.raises(rtec.InputError, match="slide"):
        rtec.fit_chain(chain, ["y slide.dx"], runs)


def test_spreadsheets_are_read_as_the_command_reads_them(tmp_path):
    points = [(25.4520, 10.0517), (26.5752, 6.4244), (9.5893, 25.5847), (7.7939, 26.2402), (23.2502, 14.3978), (16.0140, 22.1762)]
    german = "".join(f"{z:.4f};{x:.4f}\n".replace(".", ",") for z, x in points)
    (tmp_path / "plain.csv").write_text("z_mm,x_mm\n" + "".join(f"{z},{x}\n" for z, x in points), encoding="utf-8")
    (tmp_path / "named.csv").write_text("sep=;\nLaenge;Radius\n" + german, encoding="utf-16")
    (tmp_path / "nameless.csv").write_text(german, encoding="utf-8")
    want = rtec.part_errors(tmp_path / "plain.csv", radius_mm=27.35).document
    for file, columns in (
        ("named.csv", {"z_mm": "Laenge", "x_mm": "Radius"}),
        ("named.csv", {"z_mm": 1, "x_mm": 2}),
        ("nameless.csv", {"z_mm": 1, "x_mm": 2}),
    ):
        found = rtec.part_errors(tmp_path / file, columns=columns, radius_mm=27.35).document
        assert found["radius_mm"] == want["radius_mm"], (file, columns)
    with pytest.raises(rtec.InputError, match="the line that names them is missing"):
        rtec.part_errors(tmp_path / "nameless.csv", radius_mm=27.35)
