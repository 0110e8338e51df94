"""Documents are those of the command line, byte for byte."""

import filecmp
import json

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
