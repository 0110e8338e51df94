"""`rtecctl ship` to independent object stores.

s3rver (npm) writes to a disk, and can be killed or full. A gate before it checks every signature with botocore. moto keeps checksums."""

import base64
import hashlib
import http.server
import os
import pickle
import shutil
import signal
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import botocore.auth
import botocore.awsrequest
import botocore.credentials
import pytest
import shop_data as data
from conftest import ROOT, RTECCTL

import rtec
from rtec.shop import Shop, assess

S3RVER = Path(os.environ.get("RTEC_S3RVER", ROOT / "target/python/s3rver/node_modules/s3rver/bin/s3rver.js"))
# The only pair of keys that s3rver knows.
KEY, SECRET = "S3RVER", "S3RVER"


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Store:
    """A store on disk that can be killed and started again."""

    def __init__(self, folder, *options):
        assert S3RVER.exists(), f"{S3RVER}: npm install --prefix target/python/s3rver s3rver@3.7.1"
        self.folder, self.port, self.options = folder, free_port(), options
        self.scheme = "https" if "--key" in options else "http"
        folder.mkdir(exist_ok=True)
        self.start()

    def start(self):
        # Under load s3rver may leave a rejected promise unhandled, which must not end the store.
        node = ["node", "--unhandled-rejections=warn"]
        command = [*node, str(S3RVER), "-d", str(self.folder), "-a", "127.0.0.1", "-p", str(self.port), "--silent"]
        self.process = subprocess.Popen(
            [*command, "--configure-bucket", "plant", *self.options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for _ in range(1200):
            assert self.process.poll() is None, "s3rver ended"
            try:
                socket.create_connection(("127.0.0.1", self.port)).close()
                return
            except OSError:
                time.sleep(0.05)
        raise AssertionError("s3rver does not listen")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    @property
    def endpoint(self):
        return f"{self.scheme}://127.0.0.1:{self.port}"

    def objects(self):
        """The content of the bucket, read from the store's own disk."""
        marked = "._S3rver_object"
        found = (self.folder / "plant").rglob("*" + marked)
        return {str(p.relative_to(self.folder / "plant")).removesuffix(marked): p.read_bytes() for p in found}

    def shop(self, place="plant/shop"):
        options = {"endpoint_url": self.endpoint, "region_name": "us-east-1"}
        return Shop(f"s3://{place}", key=KEY, secret=SECRET, client_kwargs=options, use_listings_cache=False)


class Cutting:
    """A proxy to the store that cuts its first connection after a number of bytes; later ones pass."""

    def __init__(self, to, after):
        self.to, self.left, self.cut = to, after, False
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self.listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self.to))
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(a, b), daemon=True).start()

    def _pump(self, a, b):
        try:
            while chunk := a.recv(1024):
                if not self.cut and self.left < len(chunk):
                    b.sendall(chunk[: self.left])
                    self.cut = True
                    self.listener.close()
                    break
                self.left -= len(chunk)
                b.sendall(chunk)
        except OSError:
            pass
        for s in (a, b):
            try:
                s.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass


class Gate(http.server.BaseHTTPRequestHandler):
    """A proxy that passes requests with the signature that botocore gives, and refuses others as a store does."""

    store = None

    def _pass(self):
        address = urllib.parse.urlsplit(self.path)
        query = dict(urllib.parse.parse_qsl(address.query))
        signed = query["X-Amz-SignedHeaders"].split(";")
        region = query["X-Amz-Credential"].split("/")[2]
        own = botocore.auth.S3SigV4QueryAuth(
            botocore.credentials.Credentials(KEY, SECRET), "s3", region, expires=int(query["X-Amz-Expires"])
        )
        request = botocore.awsrequest.AWSRequest(
            self.command, f"http://{self.headers['Host']}{address.path}", {name: self.headers[name] for name in signed}
        )
        request.context["timestamp"] = query["X-Amz-Date"]
        own._modify_request_before_signing(request)
        signature = own.signature(own.string_to_sign(request, own.canonical_request(request)), request)
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        if signature != query["X-Amz-Signature"]:
            return self._answer(403, b"<Error><Code>SignatureDoesNotMatch</Code><Message>no</Message></Error>")
        onward = urllib.request.Request(f"{self.store.endpoint}{self.path}", body or None, method=self.command)
        try:
            with urllib.request.urlopen(onward) as answer:
                self._answer(answer.status, answer.read())
        except urllib.error.HTTPError as error:
            self._answer(error.code, error.read())

    do_GET = do_PUT = _pass

    def _answer(self, status, body):
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def gate(store):
    handler = type("ToStore", (Gate,), {"store": store})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("s3") / "store")
    yield store
    store.kill()


@pytest.fixture
def ship(monkeypatch):
    """Runs `rtecctl ship`, and checks that its output does not contain the secret."""
    for name in list(os.environ):
        if name.startswith("AWS_"):
            monkeypatch.delenv(name)

    def run(spool, to, endpoint, *more, code=0, key=KEY, secret=SECRET, env=None):
        command = [RTECCTL, "ship", "--spool", spool, "--to", to, "--machine", "m1", *more]
        if endpoint is not None:
            command += ["--endpoint", endpoint]
        own = {"AWS_ACCESS_KEY_ID": key, "AWS_SECRET_ACCESS_KEY": secret} if key else {}
        done = subprocess.run(
            [str(c) for c in command], capture_output=True, text=True, env={**os.environ, **own, **(env or {})}
        )
        assert code is None or done.returncode == code, done.stderr
        assert not key or secret == KEY or secret not in done.stdout + done.stderr
        assert done.stderr.count("\n") <= 1, done.stderr
        return done

    return run


def spool_of(folder, count, name="r{n}"):
    folder.mkdir()
    for n in range(count):
        data.run(n, "2026-05").write(folder / f"{name.format(n=n)}.run.toml")
    return folder


def waiting(spool):
    return sorted(p.name for p in spool.glob("*.run.toml"))


def all_there(store, count, prefix="shop"):
    """Checks that each record is there once, whole, and readable by another client."""
    assert len([k for k in store.objects() if k.startswith(f"{prefix}/inbox/") and k.endswith(".run.toml")]) == count
    shop = store.shop(f"plant/{prefix}")
    assert shop.gather() == [] and len(shop.runs()) == count
    assert {shop.get(run).to_csv() for run in shop.runs()} == {data.run(n, "2026-05").to_csv() for n in range(count)}


def test_records_arrive_once_and_another_client_reads_them(store, ship, tmp_path):
    spool = spool_of(tmp_path / "spool", 3, "spindle run {n}, ü+&")
    first = ship(spool, "s3://plant/shop", store.endpoint)
    assert first.stdout.splitlines()[-1] == "3 records sent, 0 kept"
    assert waiting(spool) == [] and len(list((spool / "sent").iterdir())) == 3
    all_there(store, 3)
    # The same records from another spool get the same places. The address from the environment works too.
    before = store.objects()
    again = spool_of(tmp_path / "again", 3, "spindle run {n}, ü+&")
    second = ship(again, "s3://plant/shop/", None, "--json", env={"AWS_ENDPOINT": store.endpoint})
    assert '"kept":[]' in second.stdout and second.stdout.count("inbox/m1/") == 3
    assert store.objects() == before


@pytest.mark.parametrize("after", [0, 500, 1100, 2000, 3500, 6000, 9000, 14000, 22000])
def test_a_connection_cut_anywhere_loses_nothing_and_sends_nothing_twice(store, ship, tmp_path, after):
    spool, prefix = spool_of(tmp_path / "spool", 3), f"cut-{after}"
    proxy = Cutting(store.port, after)
    done = ship(spool, f"s3://plant/{prefix}", f"http://127.0.0.1:{proxy.port}", code=3)
    assert proxy.cut and "records wait in the spool" in done.stderr
    # Records that have left the spool are in the store, whole.
    assert len(waiting(spool)) + len(list(spool.glob("sent/*"))) == 3
    # This store keeps half of a body, perhaps only now. Reading back shows it, and the record waits for another run.
    for _ in range(3):
        done = ship(spool, f"s3://plant/{prefix}", store.endpoint, code=None)
        assert len(waiting(spool)) + len(list(spool.glob("sent/*"))) == 3
        if done.returncode == 0:
            break
        assert "what was read back is not what was sent" in done.stderr
    assert waiting(spool) == []
    all_there(store, 3, prefix)


def test_a_store_killed_in_the_middle(tmp_path, ship):
    store = Store(tmp_path / "store")
    spool = spool_of(tmp_path / "spool", 12)

    def kill():
        while len(list(spool.glob("sent/*"))) < 4:
            time.sleep(0.002)
        store.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    ship(spool, "s3://plant/shop", store.endpoint, code=3)
    killer.join()
    assert 1 <= len(waiting(spool)) <= 8
    store.start()
    ship(spool, "s3://plant/shop", store.endpoint)
    all_there(store, 12)
    store.kill()


def test_again_and_again_goes_on_when_the_store_comes_back(tmp_path, ship):
    store = Store(tmp_path / "store")
    store.kill()
    spool = spool_of(tmp_path / "spool", 1)
    own = {"AWS_ACCESS_KEY_ID": KEY, "AWS_SECRET_ACCESS_KEY": SECRET, **os.environ}
    command = [RTECCTL, "ship", "--spool", spool, "--to", "s3://plant/shop", "--machine", "m1", "--every", "1"]
    going = subprocess.Popen([*map(str, command), "--endpoint", store.endpoint], env=own, stderr=subprocess.PIPE, text=True)
    try:
        said = going.stderr.readline()
        assert "looked at again in 1 s" in said and waiting(spool) == ["r0.run.toml"]
        store.start()
        while waiting(spool):
            assert going.poll() is None
            time.sleep(0.05)
        all_there(store, 1)
    finally:
        going.kill()
        going.wait()
        store.kill()


def test_what_the_caller_mends_is_one_line_and_exit_code_2(store, gate, ship, tmp_path):
    spool = spool_of(tmp_path / "spool", 1, "a name, with ü+& {n}")
    said = ship(spool, "s3://plant/signed", gate, code=2, secret="hush-hush-hush").stderr
    assert "SignatureDoesNotMatch" in said and "AWS_SECRET_ACCESS_KEY" in said
    said = ship(spool, "s3://plant/shop", store.endpoint, code=2, key="nobody", secret="hush-hush-hush").stderr
    assert "InvalidAccessKeyId" in said
    said = ship(spool, "s3://elsewhere/shop", store.endpoint, code=2).stderr
    assert "NoSuchBucket" in said and "make the bucket `elsewhere`" in said
    assert "found no AWS_ACCESS_KEY_ID" in ship(spool, "s3://plant", store.endpoint, code=2, key=None).stderr
    assert "expected http://HOST:PORT" in ship(spool, "s3://plant", "store.plant", code=2).stderr
    assert "AWS_REGION" in ship(spool, "s3://plant", None, code=2).stderr
    assert "expected s3://BUCKET" in ship(spool, "s3://P", store.endpoint, code=2).stderr
    assert "python -m rtec.shop ship" in ship(spool, "gs://plant", None, code=2).stderr
    assert "--endpoint" in ship(spool, tmp_path, store.endpoint, code=2).stderr
    assert len(waiting(spool)) == 1
    # A store that does not answer may answer the next time.
    assert "1 records wait" in ship(spool, "s3://plant", f"http://127.0.0.1:{free_port()}", code=3).stderr
    # With the right pair of keys the gate passes it too.
    ship(spool, "s3://plant/signed", gate)
    all_there(store, 1, "signed")


def test_a_full_store_keeps_the_spool(tmp_path, ship):
    disk = tmp_path / "store"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"nothing can be mounted here: {mounted.stderr!r}")
    try:
        store = Store(disk)
        (disk / "fill").write_bytes(bytes(shutil.disk_usage(disk).free))
        spool = spool_of(tmp_path / "spool", 2)
        assert "2 records wait in the spool" in ship(spool, "s3://plant/shop", store.endpoint, code=3).stderr
        assert len(waiting(spool)) == 2
        (disk / "fill").unlink()
        # The full disk may have ended the store, or may end it in a moment.
        store.kill()
        store.start()
        ship(spool, "s3://plant/shop", store.endpoint)
        all_there(store, 2)
        store.kill()
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def test_a_plants_own_certificate(tmp_path, ship):
    pem, key = tmp_path / "store.pem", tmp_path / "store.key"
    about = tmp_path / "about"
    about.write_text("[req]\ndistinguished_name=dn\nx509_extensions=v3\n[dn]\n[v3]\nsubjectAltName=IP:127.0.0.1\n")
    make = ["openssl", "req", "-x509", "-config", about, "-subj", "/CN=store", "-newkey", "rsa:2048", "-nodes", "-days", "2"]
    make += ["-keyout", key, "-out", pem]
    subprocess.run(make, check=True, capture_output=True)
    store = Store(tmp_path / "store", "--key", str(key), "--cert", str(pem))
    try:
        spool = spool_of(tmp_path / "spool", 1)
        assert "certificate" in ship(spool, "s3://plant/shop", store.endpoint, code=3).stderr
        bad = {"AWS_CA_BUNDLE": str(key)}
        assert "no certificate" in ship(spool, "s3://plant/shop", store.endpoint, code=2, env=bad).stderr
        ship(spool, "s3://plant/shop", store.endpoint, env={"AWS_CA_BUNDLE": str(pem)})
        assert len(store.objects()) == 2
    finally:
        store.kill()


def test_the_store_holds_our_checksum(tmp_path, ship):
    server = pytest.importorskip("moto.server")
    import boto3

    serving = server.ThreadedMotoServer(port=0)
    serving.start()
    try:
        host, port = serving.get_host_and_port()
        endpoint = f"http://{host}:{port}"
        urllib.request.urlopen(urllib.request.Request(f"{endpoint}/moto-api/reset", method="POST")).close()
        client = boto3.client(
            "s3", endpoint_url=endpoint, region_name="us-east-1", aws_access_key_id="k", aws_secret_access_key="s"
        )
        client.create_bucket(Bucket="plant")
        ship(spool_of(tmp_path / "spool", 1), "s3://plant/shop", endpoint)
        keys = [o["Key"] for o in client.list_objects_v2(Bucket="plant")["Contents"]]
        assert len(keys) == 2
        for key in keys:
            found = client.get_object(Bucket="plant", Key=key, ChecksumMode="ENABLED")
            body = found["Body"].read()
            assert found["ChecksumSHA256"] == base64.b64encode(hashlib.sha256(body).digest()).decode()
    finally:
        serving.stop()


def test_from_the_daemon_to_the_shop(rtecctl, tmp_path):
    """A probing run and a recorded one are kept by the daemon, sent and gathered. The first is a log, which is not judged."""
    for folder in ("spool", "store"):
        (tmp_path / folder).mkdir()
    axis = "count_um = 1.0\ntravel_mm = 40\nmax_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\n"
    config = tmp_path / "rtec.toml"
    config.write_text(
        f"[machine]\nname = 'm1'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\n{axis}[control]\nsocket = 's'\nspool = 'spool'\n"
    )
    daemon = subprocess.Popen([RTECCTL.with_name("rtecd"), "--config", config], stderr=subprocess.DEVNULL)
    gauge = socket.create_server(("127.0.0.1", 0))

    def say():
        near, _ = gauge.accept()
        for n in range(100_000):
            try:
                near.sendall(f"gx {n % 7}.25\n".encode())
            except OSError:
                return
            time.sleep(0.01)

    threading.Thread(target=say, daemon=True).start()
    at = ["--socket", tmp_path / "s"]
    try:
        while not (tmp_path / "s").exists():
            assert daemon.poll() is None
            time.sleep(0.05)
        rtecctl("home", *at)
        rtecctl("probe", "on", "--captures", "3", *at)
        feed = ["--feed", f"127.0.0.1:{gauge.getsockname()[1]}", "--columns", "gx=error.x", "--period", "0.05"]
        out = tmp_path / "drift.run.toml"
        rtecctl("characterise", "record", "--out", out, *feed, "--duration", "0.5", *at, "--spool")
    finally:
        daemon.terminate()
        assert daemon.wait() == 0
    rtecctl("ship", "--spool", tmp_path / "spool", "--to", tmp_path / "store", "--machine", "m1")
    shop = Shop(tmp_path / "store")
    assert shop.gather() == []
    runs = {run.key.rsplit("/", 1)[1].split("-")[0]: shop.get(run) for run in shop.runs()}
    assert set(runs) == {"probing", "drift"}
    assert runs["probing"].responses == [] and len(runs["probing"]) >= 3
    # A worker can receive it and send it back.
    assert pickle.loads(pickle.dumps(runs["probing"])).to_csv() == runs["probing"].to_csv()
    assert runs["drift"]["gx"].tolist() == rtec.read_record(out)["gx"].tolist()
    shop.put_model("m1", rtec.Machine.ideal("m1"))
    found = assess(shop)
    # Both are of today: the log is kept beside the judged record.
    assert len(found.months) == 1 and found.months.iloc[0]["runs"] == 2 and found.months["error"].isna().all()
    assert found.unreadable.empty
    # The shop's verdict on that gauge's ten readings is that of the record alone.
    alone = rtec.reconcile([rtec.read_record(out)], rtec.Machine.ideal("m1"))
    assert found.machines.iloc[0]["verdict"] == alone.verdict
