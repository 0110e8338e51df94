"""The metrologist's chapter as a notebook: run from top to bottom it gives the outputs that are stored in it.

`RTEC_BLESS=1` stores them anew.
"""

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
NOTEBOOK = Path(__file__).parents[1] / "notebooks/metrologist.ipynb"


def outputs(notebook):
    """Of each cell its words, and which of its outputs are pictures."""
    for cell in notebook.cells:
        stored = cell.get("outputs", [])
        words = "".join(o.get("text") or o.get("data", {}).get("text/plain", "") for o in stored)
        yield words, ["image/png" in o.get("data", {}) for o in stored if o.output_type != "stream"]


def test_it_gives_the_outputs_that_are_stored(tmp_path):
    stored = list(outputs(notebook := nbformat.read(NOTEBOOK, as_version=4)))
    metadata = notebook.metadata.copy()
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=resources, record_timing=False).execute()
    if os.environ.get("RTEC_BLESS"):
        notebook.metadata = metadata
        nbformat.write(notebook, NOTEBOOK)
        return
    found = list(outputs(notebook))
    for cell, expected, now in zip(notebook.cells, stored, found, strict=True):
        assert now == expected, cell.source
    assert sum(sum(pictures) for _, pictures in found) >= 6
    assert any("reversal" in words for words, _ in found)
