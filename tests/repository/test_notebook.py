"""The notebook of the docs was executed as it stands, and runs."""

import ast
import json
import re
from pathlib import Path

import pytest

import wobblesim

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = json.loads((ROOT / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))
CELLS = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
SOURCES = ["".join(cell["source"]) for cell in CELLS]


def kinds(cell):
    return {kind for output in cell["outputs"] for kind in output.get("data", {})}


def test_every_cell_was_executed_once_in_order_and_shows_something():
    assert [cell["execution_count"] for cell in CELLS] == list(range(1, len(CELLS) + 1))
    assert all(kinds(cell) or source.endswith("# quiet") for cell, source in zip(CELLS, SOURCES, strict=True))
    assert not [output for cell in CELLS for output in cell["outputs"] if output["output_type"] in ("error", "stream")]


def test_figures_are_pictures_and_the_replay_is_a_page():
    for cell, source in zip(CELLS, SOURCES, strict=True):
        if source.startswith("ws.draw("):
            assert "image/png" in kinds(cell), source
    (replay,) = [cell for cell, source in zip(CELLS, SOURCES, strict=True) if source.startswith("ws.replay(")]
    assert "text/html" in kinds(replay)


def test_it_uses_public_names_only_and_names_no_place_of_a_machine():
    used = {
        node.attr
        for source in SOURCES
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ws"
    }
    assert used <= set(wobblesim.__all__)
    assert not re.search(r"/tmp/|/roo[t]/|/hom[e]/\w", json.dumps(NOTEBOOK))


@pytest.mark.nightly  # a minute: the study of the notebook
def test_it_runs(monkeypatch):
    monkeypatch.chdir(ROOT / "docs")
    names = {}
    for source in SOURCES:
        exec(compile(source, "notebook", "exec"), names)
    assert names["outcome"].done == 16
