"""Types: mypy checks the package strictly, and its stubs against the module."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy")
CONFIG = Path(__file__).parents[1] / "pyproject.toml"


def run(*arguments, cwd):
    env = {**os.environ, "MYPY_CACHE_DIR": str(cwd / "cache")}
    done = subprocess.run([sys.executable, "-m", *arguments], cwd=cwd, env=env, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def test_the_package_is_typed(tmp_path):
    code, said = run("mypy", "--config-file", str(CONFIG), "--ignore-missing-imports", "-p", "rtec", cwd=tmp_path)
    assert code == 0, said


def test_the_stub_is_the_module(tmp_path):
    code, said = run("mypy.stubtest", "rtec._rtec", "--ignore-missing-stub", "--ignore-positional-only", cwd=tmp_path)
    assert code == 0, said


def test_a_wrong_call_is_found(tmp_path):
    (tmp_path / "wrong.py").write_text("import rtec\nrtec.evaluate(3)\nrtec.plan({'x': 'long'})\n")
    code, said = run("mypy", "--config-file", str(CONFIG), "wrong.py", cwd=tmp_path)
    assert code == 1 and said.count("error: ") == 2, said
