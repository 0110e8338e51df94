"""The usual habits of a Python library: reprs, iteration, standard errors, docstrings, pickles."""

import graphlib
import inspect
import pickle
import re
import subprocess
import sys
import types
import typing
from pathlib import Path

import numpy as np
import pytest

import rtec
from rtec import _documents

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


def test_results_are_pickled_with_all_that_they_answer(mill):
    run, base = mill / "records/linear-displacement-y.run.toml", mill / "machine.toml"
    fitted = rtec.fit_effects(run, ["offset.y"], base=base)
    for result in (rtec.evaluate(run), fitted, rtec.reconcile(run, base), rtec.read_machine(base).export("y", 0, 400), rtec.plan({"x": 500})):
        again = pickle.loads(pickle.dumps(result))
        assert type(again) is type(result) and again.document == result.document and repr(again) == repr(result)
        if hasattr(result, "regression"):
            for name, array in vars(result.regression).items():
                np.testing.assert_array_equal(getattr(again.regression, name), array, name)


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
        assert str(error) == error.args[0] and error.strerror == "No such file or directory"
        assert pickle.loads(pickle.dumps(error)).args == error.args
    with pytest.raises(FileNotFoundError):
        rtec.replay(tmp_path / "none.csv", tmp_path / "none.csv")
    # A wrong argument is not a missing file.
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


def test_no_file_of_the_package_imports_itself_in_a_circle():
    """All imports of a file count, also those only for types and those within a function."""
    folder = Path(rtec.__file__).parent
    names = {path.stem: path for path in folder.glob("*.py") if path.stem != "__init__"}
    after = {}
    for name, path in names.items():
        text = path.read_text(encoding="utf-8")
        found = set(re.findall(r"^ *from rtec\.(\w+) import", text, re.MULTILINE))
        found |= {word for line in re.findall(r"^ *from rtec import (.+)$", text, re.MULTILINE) for word in re.findall(r"\w+", line)}
        after[name] = found & names.keys()
    list(graphlib.TopologicalSorter(after).static_order())  # raises CycleError


def fits(value, kind, where):
    """Whether a value has an annotated type; a TypedDict has exactly the declared keys."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if typing.is_typeddict(kind):
        assert isinstance(value, dict), where
        hints = typing.get_type_hints(kind)
        assert value.keys() <= hints.keys(), f"{where}: not declared: {sorted(value.keys() - hints.keys())}"
        marked = typing.get_type_hints(kind, include_extras=True)
        missing = {key for key, of in marked.items() if kind.__total__ and typing.get_origin(of) is not typing.NotRequired} - value.keys()
        assert not missing, f"{where}: missing: {sorted(missing)}"
        for key, inside in value.items():
            fits(inside, hints[key], f"{where}.{key}")
    elif origin is list:
        assert isinstance(value, list), where
        for n, inside in enumerate(value):
            fits(inside, arguments[0], f"{where}[{n}]")
    elif origin is dict:
        assert isinstance(value, dict), where
        for key, inside in value.items():
            fits(inside, arguments[1], f"{where}.{key}")
    elif origin is typing.Literal:
        assert value in arguments, where
    elif origin in (typing.Union, types.UnionType):
        for one in arguments:
            try:
                return fits(value, one, where)
            except AssertionError as error:
                last = error
        raise last
    elif kind is not typing.Any:
        assert isinstance(value, (int, float) if kind is float else kind), f"{where}: {value!r} is no {kind}"


def declared(result):
    """The type of a result's document, from its class."""
    for of in type(result).__mro__:
        for base in getattr(of, "__orig_bases__", ()):
            for argument in typing.get_args(base):
                if not isinstance(argument, typing.TypeVar):
                    return argument
    raise AssertionError(type(result))


def test_documents_are_of_their_declared_types(mill, lathe, tmp_path):
    records = sorted((mill / "records").glob("*.run.toml"))
    known = mill / "machine.toml"
    straight = {"x": ("position.x", np.linspace(0, 400, 41)), "e": ("error.y", np.sin(np.arange(41.0)))}
    evaluated = [rtec.evaluate(run) for run in records]
    evaluated.append(rtec.evaluate([r for r in records if "ballbar" in r.name], "iso230-4"))
    evaluated.append(rtec.evaluate(rtec.record("s.run.toml", "positioning", straight), "straightness"))
    evaluated.append(rtec.evaluate(mill / "records/linear-displacement-y.run.toml", "repeatability"))
    drift = mill / "records/drift-dry.run.toml"
    points = tmp_path / "probed.csv"
    points.write_text("z_mm,x_mm\n0.0,10.001\n3.826834,9.238795\n7.071068,7.071068\n9.238795,3.826834\n10.002,0.0\n")
    dated = [rtec.record(f"{day}.run.toml", "positioning", straight, date=day) for day in ("2026-05-04", "2026-06-04")]
    fitted = rtec.fit(drift, base=known, sensors=["T6", "T8", "T18"], environment="T18", despite_suspicions=True)
    z = lathe / "records/linear-displacement-z.run.toml"
    verdict = rtec.reconcile(z, lathe / "machine.toml", lathe / "holdout/linear-displacement-z.run.toml")
    for result in (
        *evaluated,
        fitted,
        rtec.select_sensors(drift, base=known, sensors=["T6", "T8", "T18"]),
        rtec.fit_effects(mill / "records/linear-displacement-y.run.toml", ["offset.y"], base=known),
        fitted.machine.validate(mill / "holdout/production-cycle.run.toml"),
        verdict,
        rtec.read_machine(known).export("y", 0, 400),
        rtec.plan({"x": 500}),
        rtec.designs(counts=2000),
        rtec.part_errors(points, radius_mm=10.0),
        rtec.history(dated),
    ):
        fits(result.document, declared(result), type(result).__name__)
        if not isinstance(result.document, list):
            assert result.document["format"] == 1 and re.match(r"rtec \d+\.\d+\.\d+", result.document["by"])
    fits(rtec.where_they_disagree(z, lathe / "machine.toml").document, _documents.WhereDocument, "where")
    fits(rtec.read_machine(known).document, _documents.MachineDocument, "machine")
    assert 'by = "rtec ' in verdict.model.text and "format = 1" in run().to_sidecar()


def test_a_missing_package_is_named_with_its_extra():
    hidden = "import sys; sys.modules['pandas'] = sys.modules['matplotlib'] = sys.modules['fsspec'] = None\n"
    for code, extra in (
        ("import rtec.shop", "shop"),
        ("import rtec; rtec.record('a.run.toml', 'drift', {'e': ('error.x', [1.0])}).to_pandas()", "frames"),
    ):
        done = subprocess.run([sys.executable, "-c", hidden + code], capture_output=True, text=True)
        assert f"pip install 'rtec[{extra}]' brings it" in done.stderr, done.stderr
