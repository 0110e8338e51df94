#!/usr/bin/env python3
"""What the programs cost, and how that grows: time of the processor and peak memory of each, as tables for the guide.

    tests/cost.py growth [NAME...]   rows, columns, sensors, effects, clients, days
    tests/cost.py start              daemon: start to answering, memory, processor; a cold verb; peers where installed
    tests/cost.py records FILE...    nothing of ours: how long pandas reads these CSV files (python3 with pandas)

Needs target/release/rtecctl and rtecd (cargo build --release --workspace --bin rtecctl --bin rtecd), nothing else. It judges
nothing. Times are of the processor, user and system, so that others on this computer matter less; memory is VmHWM.
"""
import hashlib, json, math, os, shutil, signal, socket, subprocess, sys, tempfile, time
from pathlib import Path

BIN = Path(os.environ.get("RTEC_BIN", Path(__file__).parent.parent / "target/release"))
LIMIT_S = float(os.environ.get("RTEC_COST_LIMIT_S", "100"))
ENOUGH_S = 0.3


def memory_kb(pid, key="VmHWM:"):
    try:
        with open(f"/proc/{pid}/status") as status:
            for line in status:
                if line.startswith(key):
                    return int(line.split()[1])
    except (OSError, IndexError):
        pass
    return 0


def run(*command, cwd=None):
    """Processor time in s, peak memory in kB, and how it ended: 'ok', 'exit N: first line', 'more than N s'."""
    with tempfile.TemporaryFile() as err:
        child = subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL, stderr=err, cwd=cwd)
        peak, begun = 0, time.monotonic()
        while True:
            peak = max(peak, memory_kb(child.pid))
            pid, status, usage = os.wait4(child.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() - begun > LIMIT_S:
                child.kill()
                pid, status, usage = os.wait4(child.pid, 0)
                child.returncode = -9
                return usage.ru_utime + usage.ru_stime, peak, f"more than {LIMIT_S:.0f} s"
            time.sleep(0.002)
        child.returncode = os.waitstatus_to_exitcode(status)
        err.seek(0)
        said = err.read().decode(errors="replace").strip().splitlines()
        how = "ok" if child.returncode == 0 else f"exit {child.returncode}: {said[0] if said else ''}"
        return usage.ru_utime + usage.ru_stime, peak, how


def least(*command, cwd=None):
    """As `run`, the least time of several where it is short."""
    best, peak, how = run(*command, cwd=cwd)
    for _ in range(4):
        if best > ENOUGH_S or how.startswith("more"):
            break
        t, kb, how = run(*command, cwd=cwd)
        best, peak = min(best, t), max(peak, kb)
    return best, peak, how


def table(title, what, sizes, measured):
    """Prints one sweep with the exponent of its upper half; stops where a size takes too long."""
    print(f"\n{title}\n| {what} | time, s | peak, MB | exponent | end |\n|---|---|---|---|---|", flush=True)
    before = None
    for size in sizes:
        seconds, kb, how = measured(size)
        exponent = ""
        if before and seconds > 0 and before[1] > 0 and how == "ok":
            exponent = f"{math.log(seconds / before[1]) / math.log(size / before[0]):.2f}"
        print(f"| {size} | {seconds:.3f} | {kb / 1000:.1f} | {exponent} | {how} |", flush=True)
        before = (size, seconds)
        if how.startswith("more"):
            break


def record(folder, name, rows, sensors, targets=False, extra=0):
    """A drift of z with temperatures, or (targets) an axis x gone along to and fro, with a pitch error."""
    columns = {"t": ("time", "s")}
    if targets:
        columns |= {"x": ("position.x", "mm"), "dir": ("direction.x", "1")}
    columns |= {f"T{n}": ("temperature", "degC") for n in range(sensors)}
    columns |= {f"c{n}": ("channel", "V") for n in range(extra)}
    columns["e"] = ("error.x" if targets else "error.z", "um")
    random = 12345
    with open(folder / f"{name}.csv", "w") as out:
        out.write(",".join(columns) + "\n")
        warm = [0.0] * sensors
        for i in range(rows):
            spindle = 15.0 * (1 + math.sin(i / 97.0)) * (i % 1000 < 700)
            warm = [w + (spindle * (1 - 0.6 * n / max(1, sensors)) - w) / (30 + 7 * n) for n, w in enumerate(warm)]
            random = (random * 1103515245 + 12345) % 2**31
            noise = random / 2**31 - 0.5
            row = [str(60 * i)]
            error = 0.2 * noise
            if targets:
                k = i % 42
                place = min(k, 41 - k) * 25.0
                error += 0.02 * place + (0.5 if k < 21 else -0.5) + 1.5 * math.sin(2 * math.pi * place / 40.0)
                row += [f"{place:.3f}", "1" if k < 21 else "-1"]
            row += [f"{20 + w + 0.02 * math.sin(i * (n + 3)):.4f}" for n, w in enumerate(warm)]
            row += [f"{math.sin(i / (n + 2)):.4f}" for n in range(extra)]
            error += 1.3 * warm[0] if sensors else 0.0
            out.write(",".join(row) + f",{error:.4f}\n")
    kind = "positioning" if targets else "drift"
    sidecar = [f'file = "{name}.csv"', f'kind = "{kind}"', "count_um = 1.0", "[columns]"]
    sidecar += [f'{c} = {{ role = "{role}", unit = "{unit}" }}' for c, (role, unit) in columns.items()]
    (folder / f"{name}.run.toml").write_text("\n".join(sidecar) + "\n")
    return folder / f"{name}.run.toml"


def sweeps(folder):
    ctl = BIN / "rtecctl"
    model = folder / "machine.toml"
    model.write_text('name = "m"\n[[effect]]\nname = "scale.x"\nppm = 20.0\n')

    def rows(verb):
        def measured(n):
            file = record(folder, "rows", n, 0 if verb == "reconcile" else 3, targets=verb == "reconcile")
            return least(*command(verb, file))
        return measured

    def columns(verb):
        def measured(n):
            targets = verb == "reconcile"
            file = record(folder, "columns", 2000, 0 if targets else 3, targets=targets, extra=n - (4 if targets else 5))
            return least(*command(verb, file))
        return measured

    def command(verb, file):
        return {
            "evaluate": (ctl, "characterise", "evaluate", file),
            "fit": (ctl, "model", "fit", "--record", file, "--out", folder / "fitted.toml"),
            "reconcile": (ctl, "reconcile", file, "--model", model, "--out", folder / "found"),
        }[verb]

    def sensors(n):
        return least(*command("fit", record(folder, "sensors", 2000, n)))

    def effects(n):
        file = record(folder, "effects", 1000, 0, targets=True)
        waves = [f'[[effect]]\nname = "screw_periodic.x"\nperiod_mm = {1.0 + 0.05 * k:.2f}\num = 0.01\n' for k in range(n)]
        (folder / "waves.toml").write_text('name = "m"\n' + "".join(waves))
        return least(ctl, "model", "predict", "--machine", folder / "waves.toml", "--record", file, "--out", folder / "p.csv")

    def days(n):
        file = folder / "audit.log"
        written = log(file, n * 1000)
        seconds, kb, how = least(ctl, "log", "--verify", "--file", file)
        return seconds, kb, f"{how}; {written >> 20} MB kept"

    def clients(n):
        return crowd(folder, n)

    powers = [1000, 10_000, 100_000, 1_000_000]
    return {
        "rows": [(f"rows, {v}", "rows", powers, rows(v)) for v in ("evaluate", "fit", "reconcile")],
        "columns": [(f"columns, {v}, 2000 rows", "columns", [5, 10, 25, 50, 100], columns(v)) for v in ("evaluate", "fit", "reconcile")],
        "sensors": [("sensors, model fit, 2000 rows", "sensors", [1, 3, 10, 30, 100, 200], sensors)],
        "effects": [("effects, model predict, 1000 rows", "effects", [1, 10, 100, 1000], effects)],
        "days": [("days of log, 1000 commands a day, log --verify", "days", [1, 10, 100, 1000], days)],
        "clients": [("clients, each asking ten times a second for 3 s: processor time a second, memory of rtecd", "clients", [1, 10, 30, 100, 300, 1000], clients)],
    }


def log(file, lines):
    """A record of commands as the daemon writes it (ten files of 8 MiB are kept)."""
    for old in file.parent.glob(file.name + "*"):
        old.unlink()
    prev, first, kept, out, size = "0" * 64, 1, [], [], 0
    for n in range(1, lines + 1):
        entry = {"n": n, "t": f"2026-11-22T13:{n // 60 % 60:02}:{n % 60:02}.000Z", "what": "command", "uid": 0, "user": "root",
                 "role": "maintain", "request": {"do": "correct", "axis": "x", "total_counts": n % 50}, "result": "done",
                 "before": {"x": [0, 0]}, "after": {"x": [n % 50, 0]}, "prev": prev}
        body = json.dumps(entry, separators=(",", ":"))[:-1]
        prev = hashlib.sha256(body.encode()).hexdigest()
        line = f'{body},"hash":"{prev}"}}\n'
        if size >= 8 << 20:
            kept.append((first, "".join(out)))
            out, size, first = [], 0, n
        out.append(line)
        size += len(line)
    kept = (kept + [(first, "".join(out))])[-10:]
    for age, (_, text) in enumerate(reversed(kept)):
        (file if age == 0 else file.with_name(f"{file.name}.{age}")).write_text(text)
    file.with_name(file.name + ".head").write_text(json.dumps({"n": lines, "hash": prev, "first_n": kept[0][0]}))
    return sum(len(text) for _, text in kept)


class Daemon:
    """rtecd on the simulated axes, with a socket of its own."""

    def __init__(self, folder):
        self.folder = Path(tempfile.mkdtemp(dir=folder))
        self.socket = self.folder / "s"
        # The simulated axes of the embedded configuration; state and record beside the socket.
        environment = os.environ | {"XDG_STATE_HOME": str(self.folder), "XDG_RUNTIME_DIR": str(self.folder), "HOME": str(self.folder)}
        begun = time.monotonic()
        self.process = subprocess.Popen([BIN / "rtecd", "--socket", self.socket], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, env=environment, cwd=self.folder)
        while self.ask() is None:
            if self.process.poll() is not None or time.monotonic() - begun > 10:
                raise SystemExit(f"rtecd did not start: exit {self.process.poll()}")
            time.sleep(0.0005)
        self.started_s = time.monotonic() - begun

    def ask(self):
        try:
            with socket.socket(socket.AF_UNIX) as s:
                s.settimeout(5)
                s.connect(str(self.socket))
                s.sendall(b'{"do":"status"}\n')
                return json.loads(s.makefile().readline())
        except (OSError, ValueError):
            return None

    def ticks(self):
        """Processor time of every thread but the one between two edges, s."""
        total = 0
        for task in Path(f"/proc/{self.process.pid}/task").iterdir():
            name, rest = (task / "stat").read_text().rsplit(")", 1)
            if "rtec-rt" not in name:
                fields = rest.split()
                total += int(fields[11]) + int(fields[12])
        return total / os.sysconf("SC_CLK_TCK")

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(10)
        shutil.rmtree(self.folder, ignore_errors=True)


def crowd(folder, n):
    """`n` clients that ask for a status ten times a second each: processor time a second, peak memory."""
    daemon = Daemon(folder)
    sockets, refused = [], ""
    try:
        for _ in range(n):
            s = socket.socket(socket.AF_UNIX)
            s.settimeout(5)
            try:
                s.connect(str(daemon.socket))
                s.sendall(b'{"do":"status"}\n')
                line = s.makefile().readline()
                if '"status"' not in line:
                    raise OSError(line.strip()[:100] or "closed without a word")
                sockets.append(s)
            except OSError as why:
                refused = refused or f"client {len(sockets) + 1}: {why}"
                s.close()
        before, begun, answers, rounds = daemon.ticks(), time.monotonic(), 0, 0
        closed = 0
        while time.monotonic() - begun < 3:
            asked = []
            for s in sockets:
                try:
                    s.sendall(b'{"do":"status"}\n')
                    asked.append(s)
                except OSError:
                    closed += 1
            for s in asked:
                left = b"-"
                while left and not left.endswith(b"\n"):
                    left = s.recv(1 << 20)
                answers += bool(left)
                closed += not left
            rounds += 1
            time.sleep(max(0.0, begun + 0.1 * rounds - time.monotonic()))
        took = time.monotonic() - begun
        kb = memory_kb(daemon.process.pid)
        how = f"{answers / took:.0f} answers/s" + (f"; {len(sockets)} connected, {refused}" if refused else "")
        how += f"; {closed} requests met a closed connection" if closed else ""
        return (daemon.ticks() - before) / took, kb, how
    finally:
        for s in sockets:
            s.close()
        daemon.stop()


def start(folder):
    began = []
    for _ in range(9):
        daemon = Daemon(folder)
        began.append(daemon.started_s)
        daemon.stop()
    daemon = Daemon(folder)
    time.sleep(1)
    before = daemon.ticks()
    time.sleep(10)
    busy = (daemon.ticks() - before) / 10
    began.sort()
    print(f"rtecd: start to the first answer {1000 * began[4]:.1f} ms (median of 9, {1000 * began[0]:.1f} to {1000 * began[-1]:.1f}); "
          f"resident {memory_kb(daemon.process.pid, 'VmRSS:') / 1000:.1f} MB, peak {memory_kb(daemon.process.pid) / 1000:.1f} MB; "
          f"beside its polling thread {100 * busy:.2f} % of a core, idle")
    verbs = [["status", "--socket", daemon.socket], ["--version"], ["get", "axes.x.completed", "--socket", daemon.socket], ["help", "status"]]
    commands = [(f"rtecctl {v[0]}", [BIN / "rtecctl", *v]) for v in verbs]
    # What others of the trade take to say one thing.
    peers = [("gpioinfo --version", ["gpioinfo", "--version"]), ("gpsd -V", ["gpsd", "-V"]), ("chronyc --version", ["chronyc", "--version"]), ("/bin/true", ["true"])]
    commands += [(name, c) for name, c in peers if shutil.which(c[0])]
    each = {name: [] for name, _ in commands}
    for _ in range(20):  # In turns: a busy moment falls on all of them.
        for name, c in commands:
            begun = time.monotonic()
            subprocess.run([str(x) for x in c], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            each[name].append(time.monotonic() - begun)
    daemon.stop()
    for name, times in each.items():
        times.sort()
        print(f"{name:<24} p50 {1000 * times[10]:6.2f} ms   p90 {1000 * times[18]:6.2f} ms   (20 runs)")


def records(files):
    import pandas
    for file in files:
        best = min(timed(lambda: pandas.read_csv(file)) for _ in range(20))
        print(f"pandas {pandas.__version__}: {file} in {1000 * best:.2f} ms (best of 20)")


def timed(what):
    begun = time.perf_counter()
    what()
    return time.perf_counter() - begun


def main():
    what, names = (sys.argv[1:2] or [""])[0], sys.argv[2:]
    if what == "records":
        return records(names)
    for program in ("rtecctl", "rtecd"):
        if not (BIN / program).exists():
            raise SystemExit(f"{BIN / program} is not there: cargo build --release --workspace --bin rtecctl --bin rtecd")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        if what == "growth":
            all_sweeps = sweeps(folder)
            for name in names or all_sweeps:
                for sweep in all_sweeps[name]:
                    table(*sweep)
        elif what == "start":
            start(folder)
        else:
            raise SystemExit(__doc__)


main()
