"""The store of records and models of many machines."""

from __future__ import annotations

import hashlib
import io
import re
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import rtec

#: One schema for all: a row is one reading of one column. Data of the run repeats in every row, which costs nothing when packed.
SCHEMA = pa.schema(
    [
        ("run", pa.string()),
        ("sha256", pa.string()),
        ("kind", pa.string()),
        ("date", pa.string()),
        ("count_um", pa.float64()),
        ("note", pa.string()),
        ("zero", pa.string()),
        ("radius_mm", pa.float64()),
        ("plane", pa.string()),
        ("place", pa.int16()),
        ("name", pa.string()),
        ("role", pa.string()),
        ("unit", pa.string()),
        ("row", pa.int32()),
        ("value", pa.float64()),
    ]
)

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*")
_RUN = re.compile(r"records/machine=([^/]+)/month=([^/]+)/[^/]+\.parquet")


def _named(machine: str) -> str:
    if not _NAME.fullmatch(machine):
        raise ValueError(f"found the machine's name {machine!r}, expected letters, digits, '.', '_' and '-'")
    return machine


@dataclass(frozen=True)
class Run:
    """A run of the store: its machine, month (``YYYY-MM`` or ``undated``) and key."""

    machine: str
    month: str
    key: str


class Shop:
    """A store, by its URL: ``/srv/shop``, ``s3://shop``, ``memory://shop`` …

    Its options are those of fsspec."""

    def __init__(self, url: str | Path, **options: Any) -> None:
        self.url, self.options = str(url), options
        self._fs, root = fsspec.core.url_to_fs(self.url, **options)
        self._root = str(root).rstrip("/")

    def __reduce__(self) -> tuple[Any, ...]:
        return _opened, (self.url, self.options)

    def _at(self, key: str) -> str:
        return f"{self._root}/{key}"

    def _keys(self, folder: str) -> Iterator[str]:
        try:
            found = self._fs.find(self._at(folder))
        except FileNotFoundError:
            return
        for path in sorted(found):
            yield str(path)[len(self._root) + 1 :]

    def read(self, key: str) -> bytes:
        """The bytes at a place."""
        return bytes(self._fs.cat_file(self._at(key)))

    def write(self, key: str, data: bytes) -> None:
        """Puts bytes at a place, whole or not at all."""
        path = self._at(key)
        self._fs.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
        with self._fs.transaction, self._fs.open(path, "wb") as file:
            file.write(data)

    def put(self, machine: str, run: rtec.Record, *, digest: str | None = None) -> Run:
        """Puts a record into the store; the same record again gets the same place."""
        table = _table(run)
        month = run.date[:7] if run.date else "undated"
        text = (run.to_sidecar() + run.to_csv()).encode()
        digest = digest or hashlib.sha256(text).hexdigest()[:16]
        stem = Path(run.path).name.removesuffix(".run.toml")
        key = f"records/machine={_named(machine)}/month={month}/{stem}-{digest}.parquet"
        out = io.BytesIO()
        pq.write_table(table, out, compression="zstd")
        self.write(key, out.getvalue())
        return Run(machine, month, key)

    def get(self, run: Run | str) -> rtec.Record:
        """A record of the store; anything else raises :class:`rtec.InputError` or ValueError, with its place."""
        key = run.key if isinstance(run, Run) else run
        try:
            table = pq.read_table(io.BytesIO(self.read(key)))
        except (pa.ArrowInvalid, pa.ArrowException) as error:
            raise ValueError(f"{key}: found {error}, expected a record as Parquet") from error
        if not table.schema.equals(SCHEMA):
            raise ValueError(f"{key}: found the columns {table.schema.names}, expected {SCHEMA.names}")
        if table.num_rows == 0:
            raise ValueError(f"{key}: found no rows, expected a record")
        return _record(table, key)

    def runs(self) -> list[Run]:
        """Every run of the store, in order of machine and month."""
        found = ((_RUN.fullmatch(key), key) for key in self._keys("records"))
        return [Run(match[1], match[2], key) for match, key in found if match]

    def gather(self) -> list[tuple[str, str]]:
        """Moves records from the inbox into the store, each once; returns unreadable ones, with the finding."""
        there = {run.key.rsplit("-", 1)[1].removesuffix(".parquet") for run in self.runs()}
        bad: list[tuple[str, str]] = []
        for key in self._keys("inbox"):
            if not key.endswith(".run.toml"):
                continue
            parts = key.split("/")
            machine, digest = parts[1], parts[2] if len(parts) == 4 else hashlib.sha256(key.encode()).hexdigest()[:16]
            if digest in there:
                continue
            try:
                self.put(machine, self._sent(key), digest=digest)
            except (rtec.InputError, OSError, ValueError) as error:
                bad.append((key, str(error)))
        return bad

    def _sent(self, key: str) -> rtec.Record:
        with tempfile.TemporaryDirectory() as folder:
            place, name = key.rsplit("/", 1)
            for sent in self._keys(place):
                (Path(folder) / sent.rsplit("/", 1)[1]).write_bytes(self.read(sent))
            return rtec.read_record(Path(folder) / name, log=True)

    def put_model(self, machine: str, model: rtec.Machine) -> None:
        """Puts a machine's model into the store."""
        self.write(f"models/{_named(machine)}/machine.toml", model.text.encode())

    def model(self, machine: str) -> rtec.Machine:
        """A machine's model; FileNotFoundError if it has none."""
        key = f"models/{machine}/machine.toml"
        return rtec.Machine.parse(self.read(key).decode(), key)

    def models(self) -> list[str]:
        """Machines that have a model."""
        found = (key.split("/") for key in self._keys("models"))
        return [parts[1] for parts in found if len(parts) == 3 and parts[2] == "machine.toml"]

    def attributes(self) -> dict[str, dict[str, str]]:
        """The table of each machine in ``machines.toml``."""
        place = f"{self.url}/machines.toml"
        try:
            tables = tomllib.loads(self.read("machines.toml").decode())
        except FileNotFoundError:
            return {}
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{place}: found {error}, expected a table for each machine, once, as [lathe-4]") from error
        for name, of in tables.items():
            if not isinstance(of, dict):
                raise ValueError(f"{place}: found {name} = {of!r} of no machine, expected it below a table as [lathe-4]")
        return {name: {k: str(v) for k, v in of.items()} for name, of in tables.items()}


def _opened(url: str, options: dict[str, Any]) -> Shop:
    return Shop(url, **options)


def _table(run: rtec.Record) -> pa.Table:
    rows, columns = len(run), run.columns
    radius, plane = run._inner.circle or (None, None)
    about = {
        "run": Path(run.path).name,
        "sha256": run.sha256,
        "kind": run.kind,
        "date": run.date,
        "count_um": run.count_um,
        "note": run.note,
        "zero": run.zero,
        "radius_mm": radius,
        "plane": None if plane is None else ",".join(plane),
    }
    n = rows * len(columns)
    arrays: dict[str, Any] = {
        name: pa.repeat(pa.scalar(value, SCHEMA.field(name).type), n) for name, value in about.items()
    }
    arrays["place"] = np.repeat(np.arange(len(columns), dtype=np.int16), rows)
    for i, part in enumerate(("name", "role", "unit")):
        arrays[part] = np.repeat(np.array([column[i] for column in columns], dtype=object), rows)
    arrays["row"] = np.tile(np.arange(rows, dtype=np.int32), len(columns))
    arrays["value"] = np.concatenate([run[name] for name, _, _ in columns])
    return pa.table([pa.array(arrays[f.name], f.type) if not isinstance(arrays[f.name], pa.Array) else arrays[f.name] for f in SCHEMA], schema=SCHEMA)


def _record(table: pa.Table, key: str) -> rtec.Record:
    first = {name: table.column(name)[0].as_py() for name in SCHEMA.names[:9]}
    place, value = table.column("place").to_numpy(), table.column("value").to_numpy()
    order = np.lexsort((table.column("row").to_numpy(), place))
    place, value = place[order], value[order]
    starts = np.flatnonzero(np.r_[True, place[1:] != place[:-1]])
    columns: dict[str, tuple[Any, ...]] = {}
    for start, end in zip(starts, [*starts[1:], len(place)]):
        name, role, unit = (table.column(c)[int(order[start])].as_py() for c in ("name", "role", "unit"))
        columns[name] = (role, value[start:end], unit)
    plane = first["plane"].split(",") if first["plane"] else None
    about = {name: first[name] for name in ("count_um", "date", "note", "zero")}
    path = f"{key.rsplit('/', 1)[0]}/{first['run']}"
    return rtec.record(path, first["kind"], columns, radius_mm=first["radius_mm"], plane=plane, log=True, **about)


def ship(spool: str | Path, shop: Shop, machine: str) -> list[str]:
    """Sends the records of a spool folder to a store, as ``rtecctl ship`` does; returns the places.

    The CSV is sent before its sidecar. A record moves from the spool to ``sent/`` below it only after it was read back unchanged.
    If the store becomes unavailable, its own error is raised, and the unsent records stay in the spool.
    """
    places, folder = [], Path(spool)
    _named(machine)
    for sidecar in sorted(folder.glob("*.run.toml")):
        try:
            csv = rtec.read_record(sidecar, log=True).file
        except rtec.InputError:
            continue
        files = [folder / csv, sidecar]
        if Path(csv).name != csv or any(file.is_symlink() for file in files):
            continue  # files elsewhere are not read, sent or moved
        data = [file.read_bytes() for file in files]
        digest = hashlib.sha256(b"".join(hashlib.sha256(d).digest() for d in data)).hexdigest()[:16]
        place = f"inbox/{machine}/{digest}"
        for file, sent in zip(files, data):
            key = f"{place}/{file.name}"
            try:
                there: bytes | None = shop.read(key)
            except FileNotFoundError:
                there = None
            if there != sent:
                shop.write(key, sent)
                if shop.read(key) != sent:
                    raise OSError(f"{key}: what was read back is not what was sent")
        aside = folder / "sent" / digest
        aside.mkdir(parents=True, exist_ok=True)
        for file in reversed(files):
            file.rename(aside / file.name)
        places.append(place)
    return places
