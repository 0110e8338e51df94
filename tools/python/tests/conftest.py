"""Every document is compared with the output of the command line."""

import os
import subprocess
from pathlib import Path

import hypothesis
import pytest

# The same inputs in every run, so that only a change can make a run fail; RTEC_SEARCH=1 draws others.
hypothesis.settings.register_profile("same", derandomize=True)
if not os.environ.get("RTEC_SEARCH"):
    hypothesis.settings.load_profile("same")

ROOT = Path(__file__).resolve().parents[3]
RTECCTL = Path(os.environ.get("RTECCTL", ROOT / "target/debug/rtecctl"))


@pytest.fixture(scope="session")
def rtecctl():
    assert RTECCTL.exists(), f"{RTECCTL}: build it first, or name it in RTECCTL"

    def run(*arguments, cwd=None, code=0):
        command = [str(RTECCTL), *map(str, arguments)]
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, encoding="utf-8")
        assert done.returncode == code, f"{command}: {done.stderr}"
        return done

    return run


def _example(rtecctl, tmp_path_factory, name):
    folder = tmp_path_factory.mktemp(name) / name
    rtecctl("example", name, folder)
    return folder


@pytest.fixture(scope="session")
def lathe(rtecctl, tmp_path_factory):
    return _example(rtecctl, tmp_path_factory, "lathe")


@pytest.fixture(scope="session")
def mill(rtecctl, tmp_path_factory):
    return _example(rtecctl, tmp_path_factory, "mill")


@pytest.fixture(scope="session")
def spindle(rtecctl, tmp_path_factory):
    return _example(rtecctl, tmp_path_factory, "spindle")


@pytest.fixture(autouse=True)
def _quiet(recwarn):
    """Silences warnings about simulated records; tests that need them check them."""
