"""Runs as a machine shop makes them: motion, heat, clocks, gauges, set-up.

Each maker returns a `Run` with its true motion and temperatures and with the
gauge it is read on; `measure` adds the machine's error, the set-up and the
noise, and rounds as the gauge does.
"""
import numpy as np

from shop_laws import Run, lag_response, setup_columns, total


def pick(rng, values):
    """One of the values."""
    return values[int(rng.integers(len(values)))]


def log_uniform(rng, low, high):
    """A number between low and high, each factor of two as likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def signed(rng, low, high):
    """A log-uniform size with a random sign."""
    return log_uniform(rng, low, high) * (1 if rng.random() < 0.5 else -1)


class Shop:
    """A machine, its sensors and the instruments beside it."""

    def __init__(self, rng):
        self.rng = rng
        self.axes = ["x", "z"] if rng.random() < 0.2 else ["x", "y", "z"]
        self.grade = log_uniform(rng, 0.4, 3.0)      # size of its errors beside a usual machine's
        self.travel = {}
        for axis in self.axes:
            length = pick(rng, [200, 300, 400, 500, 600, 800, 1200])
            low = -length / 2 if rng.random() < 0.5 else 0.0 if rng.random() < 0.6 else -length
            self.travel[axis] = (float(low), float(low + length))
        self.sensor_step = pick(rng, [0.01, 0.01, 0.0625, 0.0625, 0.1])
        self.sensor_noise = log_uniform(rng, 0.005, 0.06)
        self.sources = ["spindle"] + list(self.axes) + ["bed", "ambient"]
        self.sensors = {}
        count = int(rng.integers(1, 9))
        for i in range(count):
            main = self.sources[i % len(self.sources)] if i == 0 or rng.random() < 0.7 else pick(rng, self.sources)
            twin = pick(rng, list(self.sensors)) if self.sensors and rng.random() < 0.2 else None
            if twin:                                   # a second sensor close to another one
                gains = {k: (g * rng.uniform(0.9, 1.1), tau * rng.uniform(0.9, 1.1))
                         for k, (g, tau) in self.sensors[twin]["gains"].items()}
                room = self.sensors[twin]["room"]
            else:
                gains = {main: (log_uniform(rng, 4, 16), log_uniform(rng, 200, 2500)) if main == "spindle" else
                         (log_uniform(rng, 1, 8), log_uniform(rng, 300, 5000))}
                for other in self.sources:
                    if other != main and rng.random() < 0.3:
                        gains[other] = (log_uniform(rng, 0.05, 0.8), log_uniform(rng, 1200, 9000))
                room = log_uniform(rng, 60, 7000)
            self.sensors[f"T{i + 1}"] = {"gains": gains, "room": room, "offset": rng.normal(0, 0.2)}
        self.session_clock = rng.random() < 0.35         # records share one clock that runs on
        self.clock = 0.0
        self.day = 0
        self.coarse_clock = pick(rng, [1e-4, 1e-3, 0.01, 0.01, 0.1, 1.0])
        self.laser_step = pick(rng, [0.001, 0.01, 0.01, 0.1])
        self.gauge_step = pick(rng, [0.1, 0.1, 0.2, 0.5, 1.0, 1.0, 10.0])
        if self.gauge_step >= 5:
            self.grade = max(self.grade, 2.0)             # a dial of 10 µm belongs to an old machine
        self.air_noise = log_uniform(rng, 0.05, 0.6)

    def new_day(self):
        """Another day: the clock begins anew, the room has another temperature."""
        self.clock = 0.0
        self.day += 1

    def start_time(self):
        """Where the next record's clock begins."""
        if self.session_clock:
            self.clock += float(self.rng.uniform(60, 1800)) if self.clock else 0.0
            return self.clock
        return float(self.rng.uniform(0, 5))

    def end_time(self, t):
        if self.session_clock:
            self.clock = float(t[-1])

    def heat(self, run, powers, warm=None):
        """Give the run its sensors' true temperatures; powers = {source: share 0..1}."""
        rng, t = self.rng, run.t - run.t[0]
        base = 20 + rng.normal(0, 1.2)
        period, span = rng.uniform(2000, 30000), log_uniform(rng, 0.1, 1.5)
        room = span * np.sin(2 * np.pi * t / period + rng.uniform(0, 6.3)) + rng.normal(0, 0.4) * t / 3600
        warm = (rng.uniform(0, 0.7) if rng.random() < 0.3 else 0.0) if warm is None else warm
        for name, sensor in self.sensors.items():
            temperature = base + sensor["offset"] + lag_response(t, room, sensor["room"])
            for source, (gain, tau) in sensor["gains"].items():
                power = room if source == "ambient" else powers.get(source)
                if power is None:
                    continue
                if source == "ambient":
                    continue
                temperature = temperature + gain * lag_response(t, power, tau, start=warm * float(np.mean(power)))
            run.temps[name] = temperature
        run.sensor_noise, run.sensor_step, run.time_step = self.sensor_noise, self.sensor_step, self.coarse_clock


def gauge(rng, run, response, sigma, step, phi=None):
    """How a response is read: white and autocorrelated noise, step of the gauge."""
    phi = (0.0 if rng.random() < 0.6 else float(rng.uniform(0.1, 0.6))) if phi is None else phi
    tails = int(rng.integers(5, 9)) if rng.random() < 0.3 else 0
    run.noise[response] = {"sigma": float(sigma), "phi": phi, "step": float(step), "tails": tails}
    run.responses.append(response)


def targets_of(shop, axis, count, jitter=True):
    """Targets of ISO 230-2: equal steps plus a random part, so that waves are not aliased."""
    low, high = shop.travel[axis]
    edge = 0.02 * (high - low)
    base = np.linspace(low + edge, high - edge, count)
    pitch = base[1] - base[0]
    if jitter:
        base = base + shop.rng.uniform(-0.3, 0.3, count) * pitch
    return np.round(base, 3)


def line(shop, axis, name, fine=False, long=False, second=None, heat_share=None, park=None):
    """A positioning line: both directions, a few cycles, the axis warms while it runs."""
    rng = shop.rng
    count = int(pick(rng, [11, 15, 21, 31, 41, 61])) if not long else int(rng.integers(80, 250))
    cycles = int(pick(rng, [1, 2, 3, 5, 5])) if not long else int(rng.integers(2, 11))
    if fine:
        low, high = shop.travel[axis]
        start = round(float(rng.uniform(low + 10, high - 10)), 2)
        step = pick(rng, [0.002, 0.003, 0.005, 0.007])
        count = int(rng.integers(60, 200))
        places = start + step * (np.arange(count) + rng.uniform(-0.3, 0.3, count))   # uneven: no aliases
        cycles = int(rng.integers(1, 4))
    else:
        places = targets_of(shop, axis, count)
    if rng.random() < 0.08 and not fine:                  # read on the way out only
        path, way = np.tile(places, cycles), np.ones(len(places) * cycles)
        cycle = np.repeat(np.arange(1, cycles + 1), len(places))
    else:
        path = np.tile(np.concatenate((places, places[::-1])), cycles)
        way = np.tile(np.repeat([1.0, -1.0], len(places)), cycles)
        cycle = np.repeat(np.arange(1, cycles + 1), 2 * len(places))
    dwell = log_uniform(rng, 2, 40) if not long else log_uniform(rng, 1, 5)
    gaps = dwell * rng.uniform(0.8, 1.25, len(path))
    setup = {}
    if len(path) > 30 and rng.random() < 0.2:             # coffee: a pause somewhere
        row = int(rng.integers(8, len(path) - 8))
        gaps[row] += rng.uniform(600, 2400)
        if rng.random() < 0.2:                            # somebody touched the stand meanwhile
            setup["jump_row"], setup["jump_um"] = row, float(rng.normal(0, 3))
    run = Run(name, "positioning", shop.start_time() + np.cumsum(gaps))
    run.setup = setup
    run.pos[axis] = path + rng.normal(0, 0.0004, len(path)) * (not fine)
    run.dir[axis], run.cycle = way, cycle
    for other in shop.axes:
        if other != axis and park is not None and other in park:
            run.pos[other] = np.full(run.n, park[other])
    run.over = float(pick(rng, [1.0, 2.0, 3.0, 5.0]))
    run.turns = "overtravel"
    if rng.random() < 0.25:
        run.turns = None                                   # nobody wrote down how it turned
    elif rng.random() < 0.1:
        run.turns, run.over = "at_target", 0.0
    if run.n > 40 and rng.random() < 0.12:                 # interrupted: the last part is missing
        run.keep_rows(np.arange(int(run.n * rng.uniform(0.6, 0.95))))
        if setup.get("jump_row", 0) >= run.n:
            setup.clear()
    shop.end_time(run.t)
    run.place_repeats = cycles
    run.logged = {"time", "cycle", "position", "direction"}
    share = (log_uniform(rng, 0.1, 1.0) if rng.random() < 0.7 else 0.0) if heat_share is None else heat_share
    shop.heat(run, {axis: np.full(run.n, share), "bed": np.full(run.n, 0.3 * share)})
    step = min(shop.laser_step, 0.01) if fine else shop.laser_step
    if shop.gauge_step >= 5 and not fine and rng.random() < 0.5:
        step = shop.gauge_step                             # no laser: a step gauge and a dial
    gauge(rng, run, f"error.{axis}", shop.air_noise * (0.3 if fine else 1), step)
    if second:
        gauge(rng, run, f"error.{second}", shop.air_noise * 1.5, max(step, 0.1))
    place_set_up(shop, run)
    return run


def bar(shop, name, plane, way=1, feed=None, centre=None, tell=None, both=False, radius=None):
    """A ballbar circle; with `both`, the other way follows after a pause."""
    rng = shop.rng
    radius = float(pick(rng, [50, 100, 150, 150, 200])) if radius is None else radius
    room = min(shop.travel[a][1] - shop.travel[a][0] for a in plane) / 2
    while radius > 0.9 * room and radius > 50:
        radius = {200.0: 150.0, 150.0: 100.0, 100.0: 50.0}[radius]
    feed = float(pick(rng, [250, 500, 1000, 2000, 4000])) if feed is None else feed
    rows = int(pick(rng, [180, 240, 360, 480, 720]))
    start = float(rng.uniform(0, 2 * np.pi))
    arc = 2 * np.pi * pick(rng, [1, 1, 1, 2])
    steps = np.arange(int(rows * arc / (2 * np.pi)))
    angle = start + way * 2 * np.pi * (steps + 0.5) / rows
    speed = feed / 60.0                                     # mm/s
    t = (steps + 0.5) * (2 * np.pi * radius / rows) / speed
    ways = np.full(len(t), float(way))
    cycle = np.ones(len(t), int)
    if both:
        angle = np.concatenate((angle, angle[::-1]))
        t = np.concatenate((t, t + t[-1] + rng.uniform(8, 30)))
        ways = np.concatenate((ways, -ways))
        cycle = np.concatenate((cycle, cycle + 1))
    run = Run(name, "ballbar", shop.start_time() + t)
    run.angle, run.cycle, run.radius, run.plane = angle, cycle, radius, list(plane)
    if centre is None:
        centre = []
        for axis in plane:
            low, high = shop.travel[axis]
            slack = max(0.0, (high - low) / 2 - radius - 5)
            centre.append(round((low + high) / 2 + float(rng.uniform(-slack, slack)), 1))
    run.centre = [float(c) for c in centre]
    for i, axis in enumerate(plane):
        turn = np.cos(angle) if i == 0 else np.sin(angle)
        along = -np.sin(angle) if i == 0 else np.cos(angle)
        run.pos[axis] = run.centre[i] + radius * turn
        run.vel[axis] = along * ways * speed
        run.dir[axis] = np.sign(run.vel[axis])
    shop.end_time(run.t)
    run.logged = {"time", "cycle"}
    tell = pick(rng, ["centre", "centre", "positions", "positions", "nothing"]) if tell is None else tell
    run.tell_centre = tell == "centre"
    if tell == "positions":
        run.logged |= {"position"}
    shop.heat(run, {a: np.full(run.n, 0.3) for a in plane})
    run.time_step = min(shop.coarse_clock, 0.01)
    step = min(shop.gauge_step, 1.0)
    gauge(rng, run, "error.r", max(0.15, shop.air_noise) * (1 + 0.3 * feed / 2000), step)
    place_set_up(shop, run)
    return run


def drift(shop, name, channel=False):
    """A spindle runs at several speeds; dials on the machine's axes are read."""
    rng = shop.rng
    rows = int(rng.integers(100, 500)) if rng.random() < 0.9 else int(rng.integers(1000, 3000))
    step = log_uniform(rng, 10, 60) if rows < 1000 else log_uniform(rng, 4, 12)
    run = Run(name, "drift", shop.start_time() + np.cumsum(step * rng.uniform(0.8, 1.2, rows)))
    top = pick(rng, [4000, 8000, 12000, 18000])
    run.rpm, run.wet = np.zeros(rows), np.zeros(rows)
    row = int(rng.integers(5, 20))
    while row < rows:
        length = int(rng.integers(12, 70)) * (1 if rows < 1000 else 5)
        run.rpm[row:row + length] = 0 if rng.random() < 0.2 else round(top * rng.uniform(0.1, 1), -2)
        if rng.random() < 0.4:
            run.wet[row + int(rng.integers(0, length)):row + length] = 1
        row += length
    shop.end_time(run.t)
    run.logged = {"time"}
    shop.heat(run, {"spindle": (run.rpm / top) ** 1.5 - 0.25 * run.wet * (run.rpm > 0)})
    if channel:
        run.channels["z9"] = np.round(np.cumsum(rng.normal(0, 0.3, rows)) + 50 + 5 * (run.rpm > 0.5 * top), 2)
    for axis in shop.axes:
        gauge(rng, run, f"error.{axis}", log_uniform(rng, 0.08, 0.4), shop.gauge_step)
    place_set_up(shop, run)
    return run


def plate(shop, name, turned=False):
    """A grid plate read in both axes; it lies shifted and may lie turned."""
    rng = shop.rng
    first, second = "x", shop.axes[1]
    nx, ny, cycles = int(rng.integers(5, 12)), int(rng.integers(5, 12)), int(rng.integers(1, 4))
    size = 0.8 * min(shop.travel[a][1] - shop.travel[a][0] for a in (first, second))
    pitch = round(size / max(nx, ny), 1)
    xs = np.arange(nx) * pitch + round(shop.travel[first][0] + 0.05 * size, 1)
    ys = np.arange(ny) * pitch + round(shop.travel[second][0] + 0.05 * size, 1)
    px, py, dx, dy, cycle = [], [], [], [], []
    for k in range(cycles):
        up = k % 2 == 0
        for j, y in enumerate(ys if up else ys[::-1]):
            forward = j % 2 == 0
            px += list(xs if forward else xs[::-1])
            dx += [1.0 if forward else -1.0] * nx
            py += [y] * nx
            dy += [1.0 if up else -1.0] * nx
            cycle += [k + 1] * nx
    t = np.cumsum(log_uniform(rng, 2, 12) * rng.uniform(0.8, 1.2, len(px)))
    run = Run(name, "plate", shop.start_time() + t)
    run.pos = {first: np.array(px), second: np.array(py)}
    run.dir = {first: np.array(dx), second: np.array(dy)}
    run.cycle = np.array(cycle)
    shop.end_time(run.t)
    run.place_repeats = cycles
    run.logged = {"time", "cycle", "position", "direction"}
    shop.heat(run, {a: np.full(run.n, 0.4) for a in (first, second)})
    for axis in (first, second):
        gauge(rng, run, f"error.{axis}", log_uniform(rng, 0.1, 0.5), min(shop.gauge_step, 1.0))
    place_set_up(shop, run)
    run.setup["turn_urad"] = float(rng.normal(0, 60)) if turned else 0.0
    return run


def dynamics(shop, axis, name):
    """An axis moves to and fro at several feeds; the drive's force is logged."""
    rng = shop.rng
    low, high = shop.travel[axis]
    stroke = min(high - low - 20, pick(rng, [50, 100, 200]))
    acc = pick(rng, [300, 900, 2000, 5000])
    step = pick(rng, [0.004, 0.01, 0.02])
    p, v, a = [low + 10], [0.0], [0.0]
    for speed in np.exp(rng.uniform(np.log(5), np.log(400), int(rng.integers(3, 7)))):
        speed = min(speed, 0.9 * np.sqrt(acc * stroke))
        ramp, cruise = speed / acc, (stroke - speed ** 2 / acc) / speed
        for sense in (1, -1):
            t = np.arange(0, 2 * ramp + cruise, step) + step / 2
            speed_now = np.clip(np.minimum(acc * t, acc * (2 * ramp + cruise - t)), 0, speed)
            at = np.where(t < ramp, acc, np.where(t > ramp + cruise, -acc, 0.0))
            p += list(p[-1] + sense * np.cumsum(speed_now) * step)
            v += list(sense * speed_now)
            a += list(sense * at)
    keep = np.arange(1, len(p))
    if len(keep) > 4000:
        keep = keep[::len(keep) // 3000 + 1]
    run = Run(name, "dynamics", shop.start_time() + keep * step)
    run.pos[axis] = np.array(p)[keep]
    run.vel[axis], run.acc[axis] = np.array(v)[keep], np.array(a)[keep]
    run.dir[axis] = np.sign(run.vel[axis])
    shop.end_time(run.t)
    run.time_step = 1e-4
    run.logged = {"time", "position", "velocity", "acceleration"}
    gauge(rng, run, f"force.{axis}", log_uniform(rng, 1.5, 10), pick(rng, [0.1, 0.5, 1.0]))
    return run


def feed_sweep(shop, axis, name, channel=False):
    """An axis passes the same places at many feeds; speed, acceleration and load are logged."""
    rng = shop.rng
    low, high = shop.travel[axis]
    passes = int(rng.integers(6, 16))
    count = int(rng.integers(12, 40))
    places = targets_of(shop, axis, count)
    p, v, a, load, t, clock = [], [], [], [], [], 0.0
    for k in range(passes):
        speed = log_uniform(rng, 3, 400)
        sense = 1 if k % 2 == 0 else -1
        weight = float(pick(rng, [0, 0, 100, 250, 500]))
        here = places[::sense]
        swing = rng.uniform(-1, 1, count) * speed * 3
        p += list(here)
        v += list(sense * speed * rng.uniform(0.7, 1.0, count))
        a += list(swing)
        load += [weight] * count
        t += list(clock + np.arange(count) * (high - low) / count / speed)
        clock = t[-1] + rng.uniform(5, 20)
    run = Run(name, "feed_sweep", shop.start_time() + np.array(t) + 0.1)
    run.pos[axis], run.vel[axis], run.acc[axis] = np.array(p), np.array(v), np.array(a)
    run.dir[axis] = np.sign(run.vel[axis])
    run.load[axis] = np.array(load)
    shop.end_time(run.t)
    run.time_step = min(0.01, shop.coarse_clock)
    run.logged = {"time", "position", "velocity", "acceleration", "load"}
    if channel:
        run.channels["z9"] = np.round(rng.normal(50, 8, run.n), 2)
    shop.heat(run, {axis: np.full(run.n, 0.5)})
    gauge(rng, run, f"error.{axis}", shop.air_noise, min(shop.gauge_step, 1.0))
    place_set_up(shop, run)
    return run


def ring(shop, name, part=False):
    """A ring or a turned part, probed by angle; read radially."""
    rng = shop.rng
    count, repeats = int(pick(rng, [24, 36, 48, 72, 120])), int(rng.integers(1, 6))
    angle = np.tile(np.linspace(0, 2 * np.pi, count, endpoint=False) + rng.uniform(0, 0.1), repeats)
    run = Run(name, "part" if part else "probing", shop.start_time() + 3.0 * np.arange(1, len(angle) + 1))
    run.angle, run.cycle = angle, np.repeat(np.arange(1, repeats + 1), count)
    shop.end_time(run.t)
    run.time_step, run.place_repeats = 0.1, repeats
    run.logged = {"time", "cycle"}
    gauge(rng, run, "error.r", log_uniform(rng, 0.15, 0.8), pick(rng, [0.1, 0.1, 0.5, 1.0]))
    place_set_up(shop, run)
    return run


def probing(shop, axis, name):
    """A probe touches from both sides at several speeds."""
    rng = shop.rng
    rows = int(rng.integers(40, 200))
    low, high = shop.travel[axis]
    run = Run(name, "probing", shop.start_time() + 4.0 * np.arange(1, rows + 1))
    run.pos[axis] = np.round(rng.uniform(low, high, rows), 3)
    way = np.where(rng.random(rows) < 0.5, 1.0, -1.0)
    run.dir[axis] = way
    run.vel[axis] = way * np.array([pick(rng, [0.5, 1.0, 2.0, 5.0, 10.0, 30.0]) for _ in range(rows)])
    shop.end_time(run.t)
    run.time_step = 0.1
    run.logged = {"time", "position", "direction", "velocity"}
    gauge(rng, run, f"error.{axis}", log_uniform(rng, 0.3, 1.2), min(shop.gauge_step, 1.0))
    place_set_up(shop, run)
    return run


def place_set_up(shop, run):
    """Draw how the instruments stood: zero, drift in air, centre, bar length."""
    rng = shop.rng
    zero = 0.0 if rng.random() < 0.2 else float(rng.normal(0, 20))
    run.setup["zero_um"] = {r: zero + float(rng.normal(0, 5)) for r in run.responses}
    if run.kind in ("positioning", "drift"):
        run.setup["drift_um_per_h"] = float(rng.normal(0, 1.0)) if run.kind == "positioning" else float(rng.normal(0, 0.3))
        run.setup["air_um"] = float(rng.uniform(0, 0.15))     # slow wander of the air path
    if "error.r" in run.responses:
        run.setup["centre_um"] = [float(rng.normal(0, 12)), float(rng.normal(0, 12))]
        if run.kind == "ballbar":
            run.setup["bar_um"] = float(rng.normal(0, 4))


def set_up_error(run, response, rng):
    """What the set-up adds to a response."""
    setup = run.setup
    hours = (run.t - run.t[0]) / 3600.0
    out = np.full(run.n, setup.get("zero_um", {}).get(response, 0.0))
    if response == "error.r":
        cx, cy = setup["centre_um"]
        out = out + cx * np.cos(run.angle) + cy * np.sin(run.angle) + setup.get("bar_um", 0.0)
    elif response.startswith("error"):
        out = out + setup.get("drift_um_per_h", 0.0) * hours
        if setup.get("jump_row"):
            out = out + setup["jump_um"] * (np.arange(run.n) >= setup["jump_row"])
        if run.kind == "plate":
            first, second = sorted(run.pos)
            if response == f"error.{first}":
                out = out - setup["turn_urad"] * run.pos[second] / 1000.0
            elif response == f"error.{second}":
                out = out + setup["turn_urad"] * run.pos[first] / 1000.0
    if setup.get("air_um") and run.n > 3:
        # Ornstein-Uhlenbeck, some 20 s of memory: too quick to look like a law.
        decay = np.exp(-np.diff(run.t) / 20.0)
        wander = np.empty(run.n)
        wander[0] = rng.normal()
        for i in range(1, run.n):
            wander[i] = decay[i - 1] * wander[i - 1] + np.sqrt(1 - decay[i - 1] ** 2) * rng.normal()
        out = out + setup["air_um"] * wander
    return out


def noise_row(noise, n, rng):
    """Noise of one response before rounding."""
    if noise.get("tails"):                               # Student's t, cut at five sigma
        white = np.clip(rng.standard_t(noise["tails"], n) / np.sqrt(noise["tails"] / (noise["tails"] - 2)), -5, 5)
        white = white * noise["sigma"]
    else:
        white = rng.normal(0, noise["sigma"], n)
    phi = noise["phi"]
    for i in range(1, n):
        white[i] = phi * white[i - 1] + np.sqrt(1 - phi ** 2) * white[i]
    return white


def measure(run, effects, extra, rng):
    """Fill `run.measured` with the gauges' numbers; `extra` is an error no law describes."""
    truth = total(effects, run)
    for response in run.responses:
        noise = run.noise[response]
        values = truth[response] + set_up_error(run, response, rng)
        if extra is not None:
            values = values + extra(run, response)
        values = values + noise_row(noise, run.n, rng)
        run.measured[response] = np.round(values / noise["step"]) * noise["step"]


def logged_columns(run, rng):
    """[(column name, role, unit, values, decimals)] as the record's file has them."""
    out = []
    if "time" in run.logged:
        clock = np.floor(run.t / run.time_step) * run.time_step
        out.append(("t", "time", "s", clock, max(0, int(np.ceil(-np.log10(run.time_step))))))
    if run.angle is not None:
        out.append(("angle", "angle", "rad", run.angle, 6))
    if "cycle" in run.logged:
        out.append(("n", "cycle", "1", run.cycle, 0))
    for key, letter, role, unit, decimals in (("position", "", "position", "mm", 5), ("direction", "dir_", "direction", "1", 0),
                                              ("velocity", "v_", "velocity", "mm/s", 4),
                                              ("acceleration", "a_", "acceleration", "mm/s2", 3), ("load", "load_", "load", "N", 1)):
        if key not in run.logged:
            continue
        table = {"position": run.pos, "direction": run.dir, "velocity": run.vel, "acceleration": run.acc, "load": run.load}[key]
        for axis in sorted(table):
            out.append((letter + axis, f"{role}.{axis}", unit, table[axis], decimals))
    if run.rpm is not None:
        out.append(("rpm", "spindle_speed", "rpm", run.rpm, 0))
    if run.wet is not None:
        out.append(("wet", "coolant", "1", run.wet, 0))
    for name in run.temps:
        read = run.temps[name] + rng.normal(0, run.sensor_noise, run.n)
        read = np.round(read / run.sensor_step) * run.sensor_step
        out.append((name, "temperature", "degC", read, 4))
    for name, values in run.channels.items():
        out.append((name, "channel", "1", values, 2))
    for response in run.responses:
        quantity, axis = response.split(".")
        unit = "N" if quantity == "force" else "um"
        out.append((("f_" if quantity == "force" else "e_") + axis, response, unit, run.measured[response], 4))
    return out
