#!/usr/bin/env python3
"""What the programs cost, and how that grows: time of the processor and peak memory of each, as tables for the guide.

    tests/cost.py growth [NAME...]   rows, columns, sensors, effects, clients, days; RTEC_PICTURE=FILE.svg draws them
    tests/cost.py start              daemon: start to answering, memory, processor; a cold verb; gpiod, gpsd, chronyd where installed
    tests/cost.py records            a CSV of 5000 x 25 and one of 10^6 x 10: our reader and the csv crate, in turns with pandas
    tests/cost.py fit [ROWS SENSORS] model fit of 1000 x 6, in turns with scikit-learn's LassoCV on as many folds
    tests/cost.py replay [EDGES]     replay of a CSV, in turns with a plain C decoder; memory bandwidth; sigrok
    tests/cost.py verbs              instructions of cold verbs, by callgrind

Needs target/release/rtecctl and rtecd (cargo build --release --workspace --bin rtecctl --bin rtecd); records and fit a python3
with pandas and scikit-learn. It judges nothing. Times are of the processor, user and system, so that others on this computer
matter less; memory is VmHWM. Peers take turns with ours, so that a busy minute falls on both.
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


CURVES = []


def table(title, what, sizes, measured):
    """Prints one sweep with the exponent from one size to the next; stops where a size takes too long."""
    print(f"\n{title}\n| {what} | time, s | peak, MB | exponent | end |\n|---|---|---|---|---|", flush=True)
    before, curve = None, []
    for size in sizes:
        seconds, kb, how = measured(size)
        exponent = ""
        if before and seconds > 0 and before[1] > 0 and how == "ok":
            exponent = f"{math.log(seconds / before[1]) / math.log(size / before[0]):.2f}"
        print(f"| {size} | {seconds:.3f} | {kb / 1000:.1f} | {exponent} | {how} |", flush=True)
        before = (size, seconds)
        if how.startswith(("more", "exit")):
            break
        curve.append((size, max(seconds, 1e-4)))
    CURVES.append((title, curve))


def picture(file):
    """The sweeps as an SVG: processor time over size, both by powers of ten; what was measured last stands at the curve's end."""
    width, height, left, top, right, bottom = 900, 560, 60, 40, 250, 50
    inks = ["#1b6ca8", "#b03a2e", "#2e7d32", "#7b5ea7", "#a86b1b", "#00838f", "#5d4037", "#c2185b", "#455a64", "#827717"]
    curves = [(t, c) for t, c in CURVES if len(c) > 1]
    xs = [math.log10(n) for _, c in curves for n, _ in c]
    ys = [math.log10(s) for _, c in curves for _, s in c]
    x0, x1, y0, y1 = 0, math.ceil(max(xs)), math.floor(min(ys)), math.ceil(max(ys))
    px = lambda x: left + (x - x0) / (x1 - x0) * (width - left - right)
    py = lambda y: height - bottom - (y - y0) / (y1 - y0) * (height - top - bottom)
    power = lambda k: f"{10.0 ** k:g}" if -4 <= k < 5 else f"10^{k}"
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
           f'<rect width="{width}" height="{height}" fill="white"/>',
           f'<text x="{left}" y="22" font-size="16">Processor time, s, over how much there is of it</text>']
    for k in range(x0, x1 + 1):
        out.append(f'<path d="M{px(k):.1f} {py(y0):.1f}V{top}" stroke="#ddd"/><text x="{px(k):.1f}" y="{height - 28}" text-anchor="middle">{power(k)}</text>')
    for k in range(y0, y1 + 1):
        out.append(f'<path d="M{left} {py(k):.1f}H{width - right}" stroke="#ddd"/><text x="{left - 8}" y="{py(k) + 4:.1f}" text-anchor="end">{power(k)}</text>')
    names = []
    for n, (title, curve) in enumerate(curves):
        ink = inks[n % len(inks)]
        at = [(px(math.log10(size)), py(math.log10(seconds))) for size, seconds in curve]
        path = "L".join(f"{x:.1f} {y:.1f}" for x, y in at)
        out.append(f'<path d="M{path}" fill="none" stroke="{ink}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{ink}"/>' for x, y in at]
        names.append((at[-1], title.split(", 2000")[0].split(", 1000")[0].split(", each")[0], ink))
    # The names one under another, in the order of the curves' ends.
    y = top
    for (x_end, y_end), name, ink in sorted(names, key=lambda each: each[0][1]):
        y = max(y + 20, min(y_end, height - bottom))
        out.append(f'<path d="M{x_end:.1f} {y_end:.1f}L{width - right + 8} {y:.1f}" stroke="{ink}" stroke-dasharray="2 3"/>'
                   f'<text x="{width - right + 12}" y="{y + 4:.1f}" fill="{ink}">{name}</text>')
    Path(file).write_text("\n".join(out + ["</svg>"]) + "\n")


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

    def axes(n):
        """Instructions of one look at n axes, an edge on each, in the place of a time: thousands as seconds."""
        steps = bench("engine_steps")
        few, many = (instructions([steps, "moving", str(looks), str(n)]) for looks in (20_000, 40_000))
        return (many - few) / 20_000 / 1000, 0, "ok"

    powers = [1000, 10_000, 100_000, 1_000_000]
    return {
        "rows": [(f"rows, {v}", "rows", powers, rows(v)) for v in ("evaluate", "fit", "reconcile")],
        "columns": [(f"columns, {v}, 2000 rows", "columns", [5, 10, 25, 50, 100], columns(v)) for v in ("evaluate", "fit", "reconcile")],
        "sensors": [("sensors, model fit, 2000 rows", "sensors", [1, 3, 10, 30, 100, 200, 300], sensors)],
        "axes": [("axes, thousand instructions of a look, an edge on each", "axes", [1, 2, 3, 4, 6], axes)],
        "effects": [("effects, model predict, 1000 rows", "effects", [1, 10, 30, 100, 300, 1000], effects)],
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
    peers = [("gpioinfo --version", ["gpioinfo", "--version"]), ("gpiodetect", ["gpiodetect"]), ("gpsd -V", ["gpsd", "-V"]), ("chronyc --version", ["chronyc", "--version"]), ("/bin/true", ["true"])]
    commands += [(name, c) for name, c in peers if shutil.which(c[0])]
    each = {name: [] for name, _ in commands}
    for _ in range(20):  # In turns: a busy moment falls on all of them.
        for name, c in commands:
            begun = time.monotonic()
            subprocess.run([str(x) for x in c], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            each[name].append(time.monotonic() - begun)
    daemon.stop()
    for name, times in each.items():
        spread(name, times)
    others(folder)


def others(folder):
    """Daemons of the trade, where installed: start to the first answer, in turns with ours; resident memory, idle processor."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}

    def gpsd():
        return subprocess.Popen(["gpsd", "-N", "-S", "29470", "-F", folder / "gpsd"], **quiet), ("127.0.0.1", 29470)

    def chronyd():
        (folder / "chrony.conf").write_text(f"cmdport 0\nport 0\nbindcmdaddress {folder}/chrony/s\npidfile {folder}/chronyd.pid\nuser root\n")
        (folder / "chrony").mkdir(mode=0o770, exist_ok=True)
        return subprocess.Popen(["chronyd", "-d", "-x", "-u", "root", "-f", folder / "chrony.conf"], **quiet), str(folder / "chrony/s")

    each, seen = {"rtecd": []}, {}
    for _ in range(9):
        daemon = Daemon(folder)
        each["rtecd"].append(daemon.started_s)
        daemon.stop()
        for begin in (gpsd, chronyd):
            if not (shutil.which(begin.__name__) or os.path.exists(f"/usr/sbin/{begin.__name__}")):
                continue
            begun = time.monotonic()
            process, door = begin()
            while process.poll() is None and time.monotonic() - begun < 10:
                if isinstance(door, str) and os.path.exists(door):
                    break
                with socket.socket() as s:
                    if not isinstance(door, str) and s.connect_ex(door) == 0:
                        s.recv(1)
                        break
                time.sleep(0.0005)
            each.setdefault(begin.__name__, []).append(time.monotonic() - begun)
            time.sleep(0.5)
            seen[begin.__name__] = memory_kb(process.pid, "VmRSS:") / 1000 if process.poll() is None else f"ended: {process.poll()}"
            process.terminate()
            process.wait(10)
    for name, times in each.items():
        spread(f"{name}: start to the first answer", times)
        if name in seen:
            print(f"    resident {seen[name]} MB")


def spread(name, times, unit=1000.0):
    """One line of a comparison in turns: median, and the quartiles."""
    times = sorted(times)
    at = lambda share: unit * times[min(len(times) - 1, int(share * len(times)))]
    print(f"{name:<44} p50 {at(0.5):9.2f} ms   quartiles {at(0.25):.2f} to {at(0.75):.2f}   ({len(times)} turns)", flush=True)
    return at(0.5)


def used(*command):
    """Processor time of a command, s."""
    before = os.times()
    subprocess.run([str(c) for c in command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system


def bench(name):
    """A bench program, as cargo built it."""
    built = subprocess.run(["cargo", "bench", "--workspace", "--bench", name, "--no-run", "--message-format=json"],
                           stdout=subprocess.PIPE, check=True).stdout.splitlines()
    found = [m["executable"] for m in map(json.loads, built) if m.get("executable") and m["target"]["name"] == name]
    return found[-1]


def records(folder):
    import pandas
    ours = bench("record_speed")
    for rows, columns, turns in [(5000, 25, 40), (1_000_000, 10, 20)]:
        file = record(folder, "read", rows, 3, extra=columns - 5)
        csv = file.parent / "read.csv"
        each = {"ours, hash and checks included": [], "csv crate, to columns": []}
        theirs = []
        for _ in range(turns):
            # Both read what the page cache holds, in a process that has read it before; the time is that of the reading alone.
            said = subprocess.run([ours, file, "5"], stdout=subprocess.PIPE, check=True, text=True).stdout.split()
            for name, ns in zip(each, said):
                each[name].append(int(ns) / 1e9)
            theirs.append(min(timed(lambda: pandas.read_csv(csv)) for _ in range(5)))
        print(f"{rows} rows x {columns} columns, {csv.stat().st_size / 1e6:.1f} MB")
        for name, times in each.items():
            spread(f"  {name}", times)
        spread(f"  pandas {pandas.__version__}", theirs)


def fit(folder, rows, sensors):
    import numpy, sklearn
    from sklearn.linear_model import LassoCV
    from sklearn.model_selection import KFold, cross_val_predict
    file = record(folder, "fit", rows, sensors)
    text = numpy.loadtxt(folder / "fit.csv", delimiter=",", skiprows=1)
    degc, growth = text[:, 1:-1], text[:, -1]
    # What ours chooses from: differences of every two sensors; a few lags of each instead of some four hundred.
    pairs = [degc[:, i] - degc[:, j] for i in range(sensors) for j in range(i)]
    def lagged(u, tau_s):
        out, y = numpy.empty_like(u), u[0]
        keep = math.exp(-60.0 / tau_s)
        for n, v in enumerate(u):
            y = v + (y - v) * keep
            out[n] = y
        return out
    offered = numpy.column_stack([c for u in pairs for c in [u, *(lagged(u, t) for t in (600.0, 2400.0, 9600.0))]])
    offered = (offered - offered.mean(axis=0)) / offered.std(axis=0)
    def lasso():
        # Twenty strengths of the penalty instead of a hundred: with a hundred, and rows of a week, it does not end.
        chosen = LassoCV(alphas=20, cv=KFold(10), max_iter=2000)
        cross_val_predict(chosen, offered, growth, cv=KFold(10))
    import warnings
    warnings.simplefilter("ignore")
    ours, theirs = [], []
    for _ in range(int(os.environ.get("RTEC_TURNS", "3"))):
        ours.append(used(BIN / "rtecctl", "model", "fit", "--record", file, "--out", folder / "fitted.toml"))
        before = time.process_time()
        lasso()
        theirs.append(time.process_time() - before)
    print(f"{rows} rows, {sensors} sensors")
    a = spread(f"ours: {len(pairs)} differences, all lags, nested", ours)
    b = spread(f"scikit-learn {sklearn.__version__} LassoCV: {offered.shape[1]} columns, nested", theirs)
    print(f"ratio {b / a:.1f}")


def replay(folder, edges):
    trace, decode, none = folder / "trace.csv", folder / "decode", folder / "none.csv"
    subprocess.run(["gcc", "-O2", "-o", decode, Path(__file__).parent / "judges/decode.c"], check=True)
    subprocess.run([decode, "--make", str(edges), trace], check=True)
    none.write_text("t_ns,requested\n")
    each = {"ours, engine included": [BIN / "rtecctl", "replay", "--trace", trace, "--requests", none],
            "plain C decoder, no engine": [decode, trace], "the same bytes, read and no more": ["wc", "-c", trace]}
    times = {name: [] for name in each}
    for _ in range(20):
        for name, command in each.items():
            times[name].append(used(*(["cat", trace] if name.startswith("the same") else command)))
    for name, own in times.items():
        median = spread(name, own)
        print(f"    {edges / max(median, 1e-3) / 1000:.1f} million edges/s")
    counts = [instructions([BIN / "rtecctl", "replay", "--trace", trace, "--requests", none])]
    subprocess.run([decode, "--make", str(edges // 2), trace], check=True)
    counts.append(instructions([BIN / "rtecctl", "replay", "--trace", trace, "--requests", none]))
    print(f"ours: {(counts[0] - counts[1]) / (edges - edges // 2):.0f} instructions an edge")
    if shutil.which("sigrok-cli"):
        few = 20_000
        subprocess.run([decode, "--make", str(few), trace], check=True)
        vcd = folder / "trace.vcd"
        subprocess.run([BIN / "rtecctl", "trace", "convert", trace, vcd], check=True, stdout=subprocess.DEVNULL)
        took = least("sigrok-cli", "-I", "vcd", "-P", "graycode:d0=a:d1=b", "-A", "graycode=count", "-i", vcd)[0]
        print(f"sigrok-cli: {few / took / 1e6:.3f} million edges/s")


def instructions(command):
    """Instructions of a command, by callgrind."""
    if not shutil.which("valgrind"):
        raise SystemExit("valgrind is not there")
    said = subprocess.run(["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *map(str, command)],
                          stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True).stderr
    return int(next(line.split()[-1] for line in said.splitlines() if "Collected" in line))


def verbs(folder):
    for verb in (["--version"], ["whoami", "--socket", folder / "none"], ["status", "--socket", folder / "none"], ["status", "--help"]):
        print(f"rtecctl {verb[0]:<12} {instructions([BIN / 'rtecctl', *verb]) / 1e6:.2f} million instructions")


def timed(what):
    begun = time.perf_counter()
    what()
    return time.perf_counter() - begun


def main():
    what, names = (sys.argv[1:2] or [""])[0], sys.argv[2:]
    for program in ("rtecctl", "rtecd"):
        if not (BIN / program).exists():
            raise SystemExit(f"{BIN / program} is not there: cargo build --release --workspace --bin rtecctl --bin rtecd")
    print(f"load of this computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        if what == "growth":
            all_sweeps = sweeps(folder)
            for name in names or all_sweeps:
                for sweep in all_sweeps[name]:
                    table(*sweep)
            if "RTEC_PICTURE" in os.environ:
                picture(os.environ["RTEC_PICTURE"])
        elif what == "replay":
            replay(folder, int((names or ["5000000"])[0]))
        elif what == "fit":
            fit(folder, *(int(n) for n in names or ("1000", "6")))
        elif what in ("start", "records", "verbs"):
            {"start": start, "records": records, "verbs": verbs}[what](folder)
        else:
            raise SystemExit(__doc__)


main()
