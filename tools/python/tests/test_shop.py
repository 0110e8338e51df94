"""Two hundred machines, three records each, on a real cluster of two workers; one is killed in the middle."""

import io
import os
import signal
import threading
import urllib.request

import numpy as np
import pytest

import rtec

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

import dask
import pyarrow as pa
import pyarrow.compute
import pyarrow.dataset
import pyarrow.parquet as pq
import shop_data as data
from dask.distributed import Client, LocalCluster

from rtec.shop import SCHEMA, Shop, assess, ship

MACHINES = int(os.environ.get("RTEC_SHOP_MACHINES", "200"))


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    shop = Shop(tmp_path_factory.mktemp("shop"))
    data.fill(shop, MACHINES)
    return shop


def test_a_record_is_the_same_after_the_store(mill, tmp_path):
    for at in (tmp_path / "shop", "memory://kept"):
        shop = Shop(at)
        for sidecar in sorted((mill / "records").glob("*.run.toml")):
            run = rtec.read_record(sidecar)
            put = shop.put("mill", run)
            again = shop.get(put)
            assert again.to_csv() == run.to_csv()
            assert again.to_sidecar() == run.to_sidecar()
            assert shop.put("mill", run) == put
        assert [r.machine for r in shop.runs()] == ["mill"] * len(list((mill / "records").glob("*.run.toml")))


def test_it_is_one_schema_partitioned_by_machine_and_month(shop):
    dataset = pa.dataset.dataset(shop.url + "/records", partitioning="hive")
    assert set(SCHEMA.names) | {"machine", "month"} == set(dataset.schema.names)
    of = dataset.to_table(filter=(pa.dataset.field("machine") == "m00003") & (pa.dataset.field("role") == "error.x"))
    assert of.num_rows == 3 * 2 * data.TARGETS * data.CYCLES
    run = data.run(3, data.MONTHS[0])
    first = of.filter(pa.compute.equal(of["run"], run.path)).sort_by("row")["value"].to_numpy()
    assert (first == run["e"]).all()


def test_causes_common_and_single_with_a_worker_killed_in_the_middle(shop):
    # One file that is not Parquet, and one with another schema.
    broken = f"records/machine={data.numbered(2)}/month=2026-06/broken-0.parquet"
    shop.write(broken, b"PAR1 nothing")
    other = io.BytesIO()
    pq.write_table(pa.table({"a": [1]}), other)
    foreign = f"records/machine={data.numbered(3)}/month=2026-05/foreign-0.parquet"
    shop.write(foreign, other.getvalue())
    killed = []
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            done = threading.Event()

            def kill():
                # As soon as both have finished some work and have more to do.
                while not done.wait(0.05):
                    finished = client.run_on_scheduler(
                        lambda dask_scheduler: sum(1 for t in dask_scheduler.tasks.values() if t.state == "memory")
                    )
                    if finished > 0:
                        victim = next(iter(client.run(os.getpid).values()))
                        os.kill(victim, signal.SIGKILL)
                        killed.append(victim)
                        return

            killer = threading.Thread(target=kill)
            killer.start()
            found = assess(shop, client, today="2026-08-01")
            done.set()
            killer.join()
            assert killed and killed[0] not in client.run(os.getpid).values()
    print(
        f"{len(found.months)} months of {MACHINES} machines, {found.months['seconds'].sum():.1f} s of a core, "
        f"{1000 * found.months['seconds'].mean():.0f} ms each"
    )
    # Nothing is lost or duplicated.
    assert len(found.machines) == MACHINES
    assert len(found.months) == 3 * MACHINES == len(found.months[["machine", "month"]].drop_duplicates())
    assert found.months["error"].isna().all()
    assert not found.figures.duplicated(["machine", "month", "run", "figure"]).any()
    assert set(found.unreadable["run"]) == {broken.rsplit("/", 1)[1], foreign.rsplit("/", 1)[1]}
    expected = {n: data.planted(n, MACHINES) for n in range(MACHINES)}
    common = {row.common: row for row in found.shared.itertuples()}
    print(found.shared.to_string())

    def planted_with(kind, month):
        return {data.numbered(n) for n, (_, each, _, _) in expected.items() if any(k == kind for k, _ in each[month])}

    heat = common["month=2026-07, hall=south"]
    assert heat.effect == "scale.x" and heat.value == pytest.approx(24.0, abs=2.0)
    batch = common["scales=batch-7"]
    assert batch.effect == "scale.x" and batch.value == pytest.approx(21.0, abs=3.0)
    assert planted_with("offset_of_scale", "2026-05") <= set(batch.machines)
    fixture = common["fixture=F3"]
    assert fixture.effect == "set_up zero_um" and fixture.value == pytest.approx(9.0, abs=0.5)
    assert set(fixture.machines) <= planted_with("fixture", "2026-06")
    assert len(fixture.machines) >= 0.8 * len(planted_with("fixture", "2026-06"))
    # Only causes that are common are reported as common.
    assert set(common) == {"month=2026-07, hall=south", "scales=batch-7", "fixture=F3"}
    # A screw that only this machine has.
    machines = found.machines.set_index("machine")
    screws = planted_with("screw", "2026-05")
    named = {m for m in screws if any(e.startswith("screw_periodic.x") for e in machines.loc[m, "own"])}
    assert len(named) >= 0.9 * len(screws)
    # A part that wore in the last month shows as a figure that left its history.
    worn = planted_with("worn", "2026-07")
    assert worn <= set(found.drifting.loc[found.drifting["figure"] == "x.B_mean", "machine"])
    assert set(found.expiring["machine"]) == {data.numbered(n) for n in range(MACHINES) if n % 41 == 5}


def test_a_shop_without_causes_shares_none(tmp_path):
    shop = Shop(tmp_path)
    for n in range(12):
        name = data.numbered(n)
        shop.put_model(name, data.model(n))
        rng = np.random.default_rng(n)
        run = data.run(n, "2026-05")
        left = data.model(n).predict(run)["e"] + rng.normal(0, 0.25, len(run))
        columns = {c: (role, run[c] if c != "e" else left) for c, role, _ in run.columns}
        shop.put(name, rtec.record(run.path, run.kind, columns, date="2026-05-15"))
    shop.write("machines.toml", "".join(f'[{data.numbered(n)}]\nhall = "{n % 2}"\n' for n in range(12)).encode())
    found = assess(shop, today="2026-08-01")
    assert found.shared.empty and found.unreadable.empty
    assert set(found.machines["verdict"]) == {"nothing_missing"}


def test_a_machine_without_a_model_is_a_row(tmp_path):
    shop = Shop(tmp_path)
    shop.put("lonely", data.run(1, "2026-05"))
    found = assess(shop)
    assert "FileNotFoundError" in found.machines.iloc[0]["error"]
    assert len(found.figures) > 0


def test_what_is_mistaken_is_said(tmp_path):
    # A folder that is empty or missing.
    for at in (tmp_path, tmp_path / "nowhere"):
        with pytest.warns(rtec.InputWarning, match="no record; what was sent to its inbox"):
            found = assess(Shop(at))
        assert found.machines.empty and found.shared.empty and found.unreadable.empty
    shop = Shop(tmp_path / "shop")
    put = shop.put("m1", data.run(1, "2026-05"))
    shop.put_model("m1", data.model(1))
    # A table that was cut off.
    whole = shop.read(put.key)
    shop.write(put.key.replace(".parquet", "x.parquet"), whole[: len(whole) // 2])
    # A machine's name that is misspelt, a table that is repeated, a key without a machine.
    shop.write("machines.toml", b'[m01]\nhall = "south"\n')
    with pytest.warns(rtec.InputWarning, match=r"\[m01\] is a machine without a record; did you mean m1\?"):
        found = assess(shop)
    assert len(found.unreadable) == 1 and "expected a record as Parquet" in found.unreadable.iloc[0]["error"]
    assert len(found.machines) == 1 and found.machines.iloc[0]["verdict"] is not None
    for text, said in ((b"[m1]\n[m1]\n", "once, as"), (b'hall = "south"\n', "of no machine"), (b"\xff", "once, as")):
        shop.write("machines.toml", text)
        with pytest.raises(ValueError, match=f"machines.toml: found .*{said}"):
            assess(shop)
    shop.write("machines.toml", b"")
    # No store answers.
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        for address in ("tcp://127.0.0.1:1", "nonsense://x"):
            with pytest.raises(ConnectionError, match=f"{address}.*expected a scheduler of Dask"):
                assess(shop, address)


def _spool(folder, count):
    folder.mkdir()
    for n in range(count):
        data.run(n, "2026-05").write(folder / f"r{n}.run.toml")
    return folder


def test_ship_by_the_command_and_by_python_is_one_place(rtecctl, tmp_path):
    to = tmp_path / "shop"
    to.mkdir()
    sent = rtecctl("ship", "--spool", _spool(tmp_path / "a", 3), "--to", to, "--machine", "m1").stdout.split()[:3]
    assert ship(_spool(tmp_path / "b", 3), Shop("memory://one"), "m1") == sorted(sent, key=sent.index)
    assert len(list(to.glob("inbox/m1/*/*.run.toml"))) == 3
    # Sent records are gathered once; broken ones are named.
    shop = Shop(to)
    bad = to / "inbox/m1/deadbeef/bad.run.toml"
    bad.parent.mkdir()
    bad.write_text("kind = 3\n")
    for _ in range(2):
        assert [key for key, _ in shop.gather()] == ["inbox/m1/deadbeef/bad.run.toml"]
        assert len(shop.runs()) == 3
    assert shop.get(shop.runs()[0]).to_csv() == data.run(0, "2026-05").to_csv()


@pytest.mark.parametrize("gone_at", range(1, 16, 2))
def test_a_store_that_goes_away_loses_nothing_and_takes_nothing_twice(tmp_path, gone_at):
    class Flaky(Shop):
        calls = 0
        writes = []

        def _call(self):
            Flaky.calls += 1
            if Flaky.calls == gone_at:
                raise ConnectionResetError("the store went away")

        def read(self, key):
            self._call()
            return super().read(key)

        def write(self, key, content):
            self._call()
            super().write(key, content)
            Flaky.writes.append(key)

    Flaky.calls, Flaky.writes = 0, []
    spool, shop = _spool(tmp_path / "spool", 3), Flaky(f"memory://flaky-{gone_at}")
    with pytest.raises(ConnectionResetError):
        ship(spool, shop, "m1")
    ship(spool, shop, "m1")
    assert not list(spool.glob("*.run.toml"))
    assert len(Flaky.writes) == len(set(Flaky.writes)) == 6
    assert shop.gather() == [] and len(shop.runs()) == 3


def test_an_object_store(tmp_path):
    """The protocol of S3, served by another program."""
    server = pytest.importorskip("moto.server")
    pytest.importorskip("s3fs")
    serving = server.ThreadedMotoServer(port=0)
    serving.start()
    try:
        host, port = serving.get_host_and_port()
        options = {
            "key": "shop",
            "secret": "shop",
            "client_kwargs": {"endpoint_url": f"http://{host}:{port}", "region_name": "eu-central-1"},
        }
        import s3fs

        # All servers of this process share their content.
        urllib.request.urlopen(urllib.request.Request(f"http://{host}:{port}/moto-api/reset", method="POST")).close()
        s3fs.S3FileSystem(**options).mkdir("plant")
        shop = Shop("s3://plant/shop", **options)
        assert len(ship(_spool(tmp_path / "spool", 2), shop, "m1")) == 2
        assert shop.gather() == [] and len(shop.runs()) == 2
        assert shop.get(shop.runs()[1]).to_csv() == data.run(1, "2026-05").to_csv()
    finally:
        serving.stop()


def test_a_record_that_was_changed_after_it_was_sent_is_not_judged_beside_itself(tmp_path):
    shop = Shop(tmp_path / "store")
    shop.put_model("m1", rtec.Machine.ideal("m1"))
    run = data.run(1, "2026-05")
    name = run.responses[0]

    def again(values):
        columns = {n: (role, values if n == name else run[n]) for n, role, _ in run.columns}
        return rtec.record(run.path, run.kind, columns, count_um=run.count_um, date=run.date, note=run.note)

    shop.put("m1", run)
    # A repeated measurement is another run of that name.
    shop.put("m1", again(run[name] + np.random.default_rng(5).normal(0, 0.05, len(run))))
    assert assess(shop).unreadable.empty
    changed = run[name].copy()
    changed[2] += 99.5
    shop.put("m1", again(changed))
    found = assess(shop)
    assert len(found.unreadable) == 2 and found.unreadable["error"].str.contains(f"{len(run) - 1} of {len(run)} rows").all()
    assert found.machines.iloc[0]["error"] is None


def test_a_misread_row_is_in_no_figure_of_the_shop(tmp_path):
    base = data.run(1, data.MONTHS[0])
    columns = {c: (role, np.array(base[c])) for c, role, _ in base.columns}
    columns["e"][1][40] += 500.0
    planted = rtec.record(base.path, base.kind, columns, date=base.date)
    without = planted.select(np.arange(len(planted)) != 40)
    figures = []
    for name, run in (("planted", planted), ("without", without)):
        shop = Shop(tmp_path / name)
        shop.put_model(data.numbered(1), data.model(1))
        shop.put(data.numbered(1), run)
        table = assess(shop).figures
        figures.append(dict(zip(table["figure"], table["value"], strict=True)))
    assert figures[0] == figures[1] and figures[0]["x.R"] < 10.0
