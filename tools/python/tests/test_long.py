"""Long calls report their progress, and end when nobody waits any more."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import rtec

#: Calls that take long on purpose, as functions without arguments.
LONG = """
import numpy as np, rtec, sys
random = np.random.default_rng(1)
n = 3000
t = np.arange(n) * 60.0
heat = np.cumsum(random.normal(size=(24, n)), axis=1)
sensors = {f"T{k}": ("temperature", 20 + 0.02 * heat[k]) for k in range(24)}
y = 0.5 * heat[3] + 0.3 * heat[7] + random.normal(size=n)
drift = rtec.record("d.run.toml", "drift", {"t": ("time", t), **sensors, "e": ("error.z", y), "f": ("error.y", y[::-1].copy())})
x = np.tile(np.concatenate([np.arange(150.0), np.arange(150.0)[::-1]]), 10)
wave = 3 * np.sin(x / 3) + 2 * np.sin(x / 7.3) + 0.1 * x + random.normal(size=n)
columns = {"t": ("time", t), "x": ("position.x", x), "e": ("error.x", wave), "g": ("error.y", wave**2)}
line = rtec.record("x.run.toml", "positioning", columns)
angle = np.linspace(0.0, 2.0 * np.pi, n)
radial = {"t": ("time", t), "a": ("angle", angle), "e": ("error.r", np.cos(2 * angle) + random.normal(size=n))}
circle = rtec.record("c.run.toml", "ballbar", radial, radius_mm=150.0, plane=("x", "y"))
calls = {
    "reconcile": lambda: [rtec.reconcile([line, drift], rtec.Machine.ideal("m")) for _ in range(100)],
    "fit": lambda: [rtec.fit(drift, despite_suspicions=True) for _ in range(100)],
    "evaluate": lambda: [rtec.evaluate(circle) for _ in range(100_000)],
    "simulate": lambda: [rtec.simulate("drift", rtec.Machine.ideal("m"), seed=k) for k in range(1000)],
    "designs": lambda: rtec.designs(counts=10_000_000),
}
"""

INTERRUPTED = """
import os, signal, threading, time, warnings
warnings.simplefilter("ignore")
# A shell that starts the tests in the background has it ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
sent = []
def later():
    time.sleep(0.7)
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=later).start()
try:
    calls[sys.argv[1]]()
except KeyboardInterrupt:
    print(f"heard after {time.monotonic() - sent[0]:.3f} s")
else:
    print("ran to its end")
"""


@pytest.mark.parametrize("name", ["reconcile", "fit", "evaluate", "simulate", "designs"])
def test_ctrl_c_is_heard_while_it_works(name):
    done = subprocess.run([sys.executable, "-c", LONG + INTERRUPTED, name], capture_output=True, text=True, timeout=600)
    print(name, done.stdout.strip())
    assert re.fullmatch(r"heard after \d+\.\d+ s\n", done.stdout), done.stdout + done.stderr


def slow():
    """A record whose reconciliation takes seconds."""
    random = np.random.default_rng(1)
    x = np.tile(np.concatenate([np.arange(150.0), np.arange(150.0)[::-1]]), 10)
    e = 3 * np.sin(x / 3) + 2 * np.sin(x / 7.3) + random.normal(size=x.size)
    return rtec.record("x.run.toml", "positioning", {"x": ("position.x", x), "e": ("error.x", e)})


def test_the_hook_hears_seconds_and_steps():
    heard = []
    with rtec.progress(heard.append):
        rtec.reconcile(slow(), rtec.Machine.ideal("m"))
    rtec.reconcile(slow(), rtec.Machine.ideal("m"))
    seconds, steps = zip(*heard)
    assert sorted(seconds) == list(seconds) and sorted(steps) == list(steps) and steps[-1] > 0


def test_what_the_hook_raises_ends_the_call_and_what_works_for_it():
    class Stop(Exception):
        pass

    def stop(_):
        raise Stop

    threads = set(os.listdir("/proc/self/task"))
    with pytest.raises(Stop), rtec.progress(stop):
        rtec.reconcile(slow(), rtec.Machine.ideal("m"))
    # The working thread ends at its next step, however busy the computer is.
    while set(os.listdir("/proc/self/task")) - threads:
        time.sleep(0.01)


def test_a_handler_of_the_program_s_own_is_called():
    heard = []
    before = signal.signal(signal.SIGUSR1, lambda *_: heard.append("in time"))
    try:
        with rtec.progress(lambda p: p.steps and not heard and os.kill(os.getpid(), signal.SIGUSR1)):
            rtec.reconcile(slow(), rtec.Machine.ideal("m"))
        assert heard
    finally:
        signal.signal(signal.SIGUSR1, before)
