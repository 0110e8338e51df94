"""Only arrays, errors and warnings pass from Rust to Python, whatever the input."""

import copy
import pathlib
import pickle
import threading
import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rtec

ROLES = ["time", "position.x", "direction.x", "temperature", "channel", "error.x", "cycle", "angle", "error.r"]
KINDS = ["positioning", "drift", "ballbar", "plate", "dynamics", "probing", "feed_sweep", "part"]


def small(**about):
    columns = {
        "t": ("time", [0.0, 1.0, 2.0, 3.0]),
        "x": ("position.x", [0.0, 10.0, 10.0, 0.0]),
        "T1": ("temperature", [20.0, 20.5, 21.0, 21.5]),
        "air": ("channel", [5.1, 5.2, 5.0, 5.1], "bar"),
        "e": ("error.x", [0.0, 1.25, 1.5, 1e-9]),
    }
    return rtec.record("small.run.toml", "positioning", columns, **about)


def test_what_computes_is_as_well_optimised_as_in_the_workspace():
    def optimised(folder):
        return tomllib.loads((folder / "Cargo.toml").read_text())["profile"]["dev"]["package"]

    own = pathlib.Path(__file__).resolve().parents[1]
    linked = {package["name"] for package in tomllib.loads((own / "Cargo.lock").read_text())["package"]}
    expected = {name: how for name, how in optimised(own.parents[1]).items() if name in linked}
    assert expected == optimised(own)


def test_numbers_go_in_and_out_as_they_are(tmp_path):
    run = small(date="2026-05-01", note="by hand", zero="plate", count_um=0.5)
    written = run.write(tmp_path / "other.run.toml")
    again = rtec.read_record(tmp_path / "other.run.toml")
    assert written.sha256 == again.sha256 != ""
    assert again.columns == run.columns == [
        ("t", "time", "s"),
        ("x", "position.x", "mm"),
        ("T1", "temperature", "degC"),
        ("air", "channel", "bar"),
        ("e", "error.x", "um"),
    ]
    for name, _, _ in run.columns:
        assert again[name].dtype == np.float64 and again[name].shape == (len(run),) == (4,)
        assert (again[name] == run[name]).all()
    assert (again["temperature.T1"] == run["T1"]).all() and again.responses == ["e"]
    assert (again.date, again.note, again.zero, again.count_um) == ("2026-05-01", "by hand", "plate", 0.5)
    for same in (copy.copy(run), pickle.loads(pickle.dumps(run))):
        assert same.to_csv() == run.to_csv() and same.to_sidecar() == run.to_sidecar()
    # A returned array is a copy.
    run["e"][0] = 99.0
    assert run["e"][0] == 0.0
    assert (run.select([1, 2])["e"] == [1.25, 1.5]).all()
    assert (run.select(run["e"] > 1.0)["x"] == [10.0, 10.0]).all()


def test_frames(tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = small().to_pandas()
    assert frame.attrs["e"] == {"role": "error.x", "unit": "um"} and frame.shape == (4, 5)
    again = rtec.record("f.run.toml", "positioning", frame, {"x": "position.x", "e": "error.x"})
    assert [name for name, _, _ in again.columns] == ["x", "e"]
    assert isinstance(frame, pandas.DataFrame)


def test_bad_input_is_one_error_with_its_place(tmp_path):
    small().write(tmp_path / "a.run.toml")
    csv = tmp_path / "a.csv"
    csv.write_text(csv.read_text().replace("1.25", "much"))
    with pytest.raises(rtec.InputError) as raised:
        rtec.read_record(tmp_path / "a.run.toml")
    error = raised.value
    assert (error.file, error.line, error.column) == (str(csv), 3, 15)
    assert "much" in error.found and error.expected and str(error).startswith(f"{csv}:3:15: found ")
    assert isinstance(error, ValueError)
    with pytest.raises(rtec.InputError, match="no response"):
        rtec.record("b.run.toml", "drift", {"t": ("time", [1.0])})
    with pytest.raises(rtec.InputError, match=r"m.toml:2:"):
        rtec.Machine.parse('name = "a"\nwrong = 1\n', "m.toml")
    for call in (
        lambda: rtec.evaluate([]),
        lambda: rtec.evaluate(small(), "iso9000"),
        lambda: rtec.evaluate(small(), norm=7),
        lambda: rtec.fit([]),
        lambda: rtec.fit(small(), folds=1),
        lambda: rtec.fit_effects(small(), []),
        lambda: rtec.reconcile([], rtec.Machine.ideal("m")),
        lambda: rtec.reconcile(small(), rtec.Machine.ideal("m"), level=0.9),
        lambda: rtec.plan({}),
        lambda: rtec.plan({"x": float("nan")}),
        lambda: rtec.designs("abacus"),
        lambda: rtec.designs(counts=0),
        lambda: rtec.simulate("nothing"),
        lambda: rtec.example("nothing", tmp_path / "new"),
        lambda: rtec.replay(tmp_path / "none.csv", tmp_path / "none.csv"),
        lambda: rtec.part_errors(tmp_path / "none.csv"),
        lambda: rtec.read_machine(tmp_path / "none.toml"),
        lambda: small().select([]),
        lambda: small().write(tmp_path / "no-suffix.toml"),
        lambda: rtec.Machine.ideal("m").half_widths_um(small(), "speed"),
        lambda: rtec.Machine.ideal("m").doubts("yesterday"),
    ):
        with pytest.raises(rtec.InputError):
            call()
    with pytest.raises(KeyError):
        small()["nothing"]
    with pytest.raises(IndexError):
        small().select([4])
    with pytest.raises(IndexError):
        small().select([-1])
    with pytest.raises(OSError):
        small().write(tmp_path / "no/such/folder.run.toml")


def test_what_is_said_is_a_warning_and_stands_in_the_result(mill):
    run = mill / "records/linear-displacement-y.run.toml"
    with pytest.warns(rtec.InputWarning, match="no uncertainty") as seen:
        found = rtec.evaluate(run)
    assert seen[0].filename == __file__
    assert any("no uncertainty" in line for line in found.said)


def test_the_lock_is_free_while_rust_works(lathe):
    run, known = rtec.read_record(lathe / "records/drift-dry.run.toml"), rtec.Machine.ideal("nothing")
    begun = threading.Event()

    def reconcile():
        begun.set()
        rtec.reconcile(run, known)

    worker = threading.Thread(target=reconcile)
    worker.start()
    begun.wait()
    turns = 0
    while worker.is_alive():
        turns += 1
        worker.join(1e-4)
    # If the work held the lock, this thread would run only once, at the end.
    assert turns > 50


numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 1.0, -1.0, 5.0, 20.0]), st.floats(-50, 50)
)


@st.composite
def columns(draw):
    """Columns with odd values, mostly of a valid record."""
    odd = draw(st.integers(0, 3)) == 0
    rows = draw(st.integers(0 if odd else 1, 40))
    roles = draw(st.lists(st.sampled_from(ROLES), max_size=5, unique=not odd))
    roles += [] if odd or "error.x" in roles else ["error.x"]
    kind = draw(st.sampled_from(KINDS + ["walk"] * odd))
    whole = st.integers(-3, 3).map(float)
    values = draw(st.sampled_from([whole, st.floats(-1e3, 1e3), st.floats(-1e-300, 1e-300)]))
    made = {}
    for i, role in enumerate(roles):
        name = draw(st.one_of(st.just(f"c{i}"), st.text(max_size=4))) if odd else f"c{i}"
        length = draw(st.sampled_from([rows, rows, rows, rows + 1])) if odd else rows
        of = numbers if odd else st.sampled_from([-1.0, 1.0]) if role.startswith("direction") else values
        data = draw(st.lists(of, min_size=length, max_size=length))
        made[name] = (role, data if odd or role != "time" else sorted(data))
    return kind, made


allowed = (rtec.InputError, rtec.RtecError)


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(columns())
def test_no_record_brings_more_than_an_error(tmp_path, given):
    kind, made = given
    try:
        run = rtec.record("any.run.toml", kind, made)
    except allowed:
        return
    again = rtec.read_record(run.write(tmp_path / "any.run.toml").path)
    assert again.to_csv() == run.to_csv() and again.columns == run.columns
    run.suspicions()
    model = rtec.Machine.parse('name = "m"\n[[effect]]\nname = "scale.x"\nppm = 3.0\n')
    calls = [lambda s=s: rtec.evaluate(run, s) for s in (None, "iso230-2", "iso230-3", "ballbar", "plate")]
    calls += [lambda s=s: rtec.evaluate(run, s) for s in ("straightness", "repeatability", "iso230-6")]
    calls += [
        lambda: model.predict(run),
        lambda: rtec.select_sensors(run),
        lambda: rtec.fit(run),
        lambda: rtec.fit_effects(run, ["offset.x"]),
        lambda: rtec.where_they_disagree(run, model),
        lambda: rtec.reconcile(run, model),
    ]
    for call in calls:
        try:
            call()
        except allowed:
            pass


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.text(max_size=60), st.text("[]=\"'.\n#{}e[ffct]name0123456789,µ", max_size=60)))
def test_no_model_brings_more_than_an_error(text):
    try:
        rtec.Machine.parse(text).document
    except allowed:
        pass


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(numbers, numbers), max_size=12), st.one_of(st.none(), numbers), numbers)
def test_no_points_bring_more_than_an_error(tmp_path, points, radius, tip):
    file = tmp_path / "points.csv"
    file.write_text("z_mm,x_mm\n" + "".join(f"{z},{x}\n" for z, x in points))
    try:
        rtec.part_errors(file, radius_mm=radius, tip_mm=tip)
    except allowed:
        pass


def test_what_numpy_would_take_for_other_numbers_is_refused_or_converted():
    seconds = np.arange(5)
    e = np.array([0.5, 1.5, 2.25, 3.5, 4.75])

    def made(time, error=e):
        return rtec.record("d.run.toml", "drift", {"t": ("time", time), "e": ("error.z", error)})

    for unit in ["s", "ms", "us", "ns"]:
        assert made(seconds.astype("timedelta64[s]").astype(f"timedelta64[{unit}]")).time_s.tolist() == seconds.tolist()
    assert made(60 * seconds.astype("timedelta64[m]")).time_s.tolist() == (3600 * seconds).tolist()
    day = np.datetime64("2026-05-01")
    for unit in ["s", "ms", "us", "ns"]:
        with pytest.raises(TypeError, match="expected seconds since the run began"):
            made((day + seconds.astype("timedelta64[s]")).astype(f"datetime64[{unit}]"))
    for values in [seconds.astype("timedelta64[s]"), e + 1j, e.astype(str)]:
        with pytest.raises(TypeError, match="column 'e'"):
            made(seconds, values)
    with pytest.raises(ValueError, match="masked"):
        made(seconds, np.ma.masked_array(np.where(e > 3, -9999, e), e > 3))
    assert made(seconds, np.ma.masked_array(e)).columns == made(seconds).columns


def test_a_record_is_written_as_a_record(tmp_path):
    run = rtec.record("d.run.toml", "drift", {"t": ("time", [0.0, 1.0]), "e": ("error.z", [0.5, 1.5])})
    for name in ["z.csv", ".run.toml", "d.toml"]:
        with pytest.raises((ValueError, rtec.InputError), match="NAME.run.toml"):
            run.write(tmp_path / name)
    with pytest.raises(rtec.InputError, match="NAME.run.toml"):
        rtec.record("z.csv", "drift", {"e": ("error.z", [0.5, 1.5])}).write()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="folds -3"):
        rtec.fit(run, folds=-3)
    with pytest.raises(rtec.InputError, match="expected `um`"):
        rtec.record("d.run.toml", "drift", {"e": ("error.z", [0.5, 1.5], "mm")})
