"""What a reader of Python expects of a library: reprs, iteration, standard errors, docstrings, pickles."""

import inspect
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

import rtec

T = np.linspace(0.0, 1.0, 5)


def run():
    columns = {"t": ("time", T), "x": ("position.x", 10 * T), "e": ("error.x", T - 0.5)}
    return rtec.record("a.run.toml", "drift", columns, date="2026-05-04", zero="one")


def test_a_record_iterates_over_its_columns():
    record = run()
    assert list(record) == record.keys() == ["t", "x", "e"]
    assert "e" in record and "error.x" in record and "y" not in record and 3 not in record
    assert len(record) == 5
    page = record._repr_html_()
    assert page.count("<tr>") == 4 and "error.x" in page and "0.5" in page


def test_pickles_keep_hash_and_everything_else(tmp_path):
    written = run().write(tmp_path / "a.run.toml")
    assert len(written.sha256) == 64
    again = pickle.loads(pickle.dumps(written))
    for name in ("path", "file", "sha256", "kind", "count_um", "date", "note", "zero", "columns"):
        assert getattr(again, name) == getattr(written, name), name
    assert again.to_csv() == written.to_csv() and again.to_sidecar() == written.to_sidecar()
    assert pickle.loads(pickle.dumps(run())).sha256 == ""
    model = tmp_path / "m.toml"
    rtec.Machine.ideal("m").write(model)
    read = rtec.read_machine(model)
    assert pickle.loads(pickle.dumps(read)).sha256 == read.sha256


def test_errors_have_one_base_and_a_standard_class(tmp_path):
    for kind, standard in ((rtec.InputError, ValueError), (rtec.MissingFileError, FileNotFoundError), (rtec.Bug, RuntimeError)):
        assert issubclass(kind, rtec.RtecError) and issubclass(kind, standard)
    missing = tmp_path / "no such"
    model = rtec.Machine.ideal("m")
    for call in (
        lambda: rtec.read_record(missing),
        lambda: rtec.read_machine(missing),
        lambda: rtec.evaluate(missing),
        lambda: rtec.evaluate(run(), conditions=missing),
        lambda: rtec.fit(missing),
        lambda: rtec.reconcile(missing, model),
        lambda: rtec.fit_chain(missing, ["z slide.dx"], [run()]),
        lambda: rtec.part_errors(missing),
        lambda: rtec.import_record(missing, "csv", tmp_path / "b.run.toml", columns={"e": "error.x"}),
    ):
        with pytest.raises(FileNotFoundError) as raised:
            call()
        error = raised.value
        assert isinstance(error, rtec.InputError) and error.filename == error.file == str(missing), error
        assert pickle.loads(pickle.dumps(error)).args == error.args
    with pytest.raises(FileNotFoundError):
        rtec.replay(tmp_path / "none.csv", tmp_path / "none.csv")
    # An argument that is wrong is no missing file.
    with pytest.raises(rtec.InputError) as raised:
        rtec.evaluate(run(), "iso9000")
    assert not isinstance(raised.value, OSError)


def test_errors_speak_of_arguments(mill):
    with pytest.raises(rtec.InputError) as raised:
        rtec.read_machine(mill / "machine.toml").export("y", 0, 400, format="ssfk")
    assert "axis_number" in str(raised.value) and "--" not in str(raised.value) + raised.value.expected
    from rtec._errors import for_python

    assert for_python("no --tip-mm; `rtecctl part points --tip-mm 2`") == "no tip_mm; `rtecctl part points --tip-mm 2`"


def test_a_string_is_no_list_of_names():
    record = run()
    for call in (
        lambda: rtec.fit(record, sensors="T0"),
        lambda: rtec.select_sensors(record, sensors="T0"),
        lambda: rtec.fit_effects(record, "scale.x"),
        lambda: rtec.fit_chain("chain.toml", "z slide.dx", [record]),
        lambda: rtec.import_record("a.csv", "csv", "b.run.toml", columns="e=error.x"),
        lambda: rtec.record("b.run.toml", "ballbar", {"e": ("error.r", T)}, radius_mm=1.0, plane="xy"),
    ):
        with pytest.raises(TypeError, match="expected a list of names"):
            call()


def test_results_show_verdict_and_figures(mill):
    records = mill / "records"
    found = rtec.evaluate(records / "linear-displacement-y.run.toml")
    assert re.search(r"^<rtec\.Evaluation .*A [0-9]", repr(found)), repr(found)
    verdict = rtec.reconcile(records / "linear-displacement-y.run.toml", mill / "machine.toml")
    assert repr(verdict).startswith(f"<rtec.Verdict verdict {verdict.verdict}")
    for effect in verdict.effects:
        assert effect["name"] in repr(verdict) and effect["name"] in verdict._repr_html_()
    assert "<table>" in verdict._repr_html_()
    planned = rtec.plan({"x": 500})
    assert repr(planned) == f"<rtec.Plan entries {len(planned.document)}>"


def documented():
    """Public functions, and methods of public classes."""
    for name in rtec.__all__:
        thing = getattr(rtec, name)
        if inspect.isfunction(thing):
            yield name, thing
        elif inspect.isclass(thing) and not issubclass(thing, BaseException):
            for method, of in inspect.getmembers(thing, inspect.isfunction):
                if not method.startswith("_") and of.__module__.startswith("rtec."):
                    yield f"{name}.{method}", of


@pytest.mark.parametrize(("name", "function"), list(documented()))
def test_docstrings_name_every_parameter_and_the_result(name, function):
    text = inspect.getdoc(function) or ""
    signature = inspect.signature(function)
    wanted = [p for p in signature.parameters if p != "self"]
    head, _, section = text.partition("Parameters\n----------\n")
    given = re.findall(r"^(\w+) : .+\n    \S", section.partition("\nReturns\n")[0], re.MULTILINE)
    assert given == wanted, name
    assert head.strip() and head.split("\n")[0].endswith((".", ":")), name
    assert ("Returns\n-------\n" in text) == (signature.return_annotation != "None"), name


def test_a_missing_package_is_named_with_its_extra():
    hidden = "import sys; sys.modules['pandas'] = sys.modules['matplotlib'] = sys.modules['fsspec'] = None\n"
    for code, extra in (
        ("import rtec.shop", "shop"),
        ("import rtec; rtec.record('a.run.toml', 'drift', {'e': ('error.x', [1.0])}).to_pandas()", "frames"),
    ):
        done = subprocess.run([sys.executable, "-c", hidden + code], capture_output=True, text=True)
        assert f"pip install 'rtec[{extra}]' brings it" in done.stderr, done.stderr
