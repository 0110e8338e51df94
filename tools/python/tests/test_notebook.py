"""The metrologist's chapter as a notebook: it is stored with what it prints and draws.

It is run from top to bottom and compared; `RTEC_BASELINE=write` stores its outputs anew.
"""

import base64
import copy
import os
import re
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
test_plots = pytest.importorskip("test_plots")
NOTEBOOK = Path(__file__).parents[1] / "notebooks/metrologist.ipynb"


def texts(cell):
    """What a cell prints, without addresses: they differ from run to run."""
    data = (output.get("data") or {output.get("name"): output["text"]} for output in cell.get("outputs", []))
    return [{kind: re.sub(r"0x[0-9a-f]{6,}", "0x", text) for kind, text in each.items() if kind != "image/png"} for each in data]


def pictures(cell):
    drawn = (output.get("data", {}).get("image/png") for output in cell.get("outputs", []))
    return [base64.b64decode(png) for png in drawn if png]


@pytest.fixture(scope="module")
def stored():
    return nbformat.read(NOTEBOOK, as_version=4)


@pytest.fixture(scope="module")
def run(stored, tmp_path_factory):
    """The notebook after a run, with nothing in it of when and where."""
    notebook = copy.deepcopy(stored)
    where = {"metadata": {"path": str(tmp_path_factory.mktemp("notebook"))}}
    nbclient.NotebookClient(notebook, timeout=600, resources=where, record_timing=False).execute()
    notebook.metadata = stored.metadata
    if os.environ.get("RTEC_BASELINE") == "write":
        nbformat.write(notebook, NOTEBOOK)
        stored.cells = notebook.cells
    return notebook


def test_it_is_stored_with_what_it_prints(stored, run):
    for kept, found in zip(stored.cells, run.cells, strict=True):
        assert texts(kept) == texts(found), f"RTEC_BASELINE=write stores it anew:\n{kept.source}"
        assert kept.get("execution_count") == found.get("execution_count")
    assert all(cell.outputs for cell in stored.cells if cell.cell_type == "code")
    assert "reversal" in str([texts(cell) for cell in stored.cells])


def test_it_is_stored_with_what_it_draws(stored, run, tmp_path):
    pairs = [pair for both in zip(stored.cells, run.cells) for pair in zip(*map(pictures, both), strict=True)]
    assert len(pairs) >= 6
    for pair in pairs:
        files = [tmp_path / "stored.png", tmp_path / "found.png"]
        for file, png in zip(files, pair, strict=True):
            file.write_bytes(png)
        differs = test_plots.compare.compare_images(*map(str, files), test_plots.TOLERANCE)
        assert differs is None, differs


def test_another_output_is_seen(run):
    """What cannot fail is no test: a number less is another text."""
    changed = copy.deepcopy(run)
    output = next(o for cell in changed.cells for o in cell.get("outputs", []) if "text" in o)
    output["text"] = output["text"][:-2]
    assert [texts(cell) for cell in changed.cells] != [texts(cell) for cell in run.cells]
