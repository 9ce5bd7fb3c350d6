"""`wobblesim explain`: what it says of a small study, before and after it has been computed.

Three seeds or more on one thread, in double precision: all lanes are in full blocks, of a width that other tests
compile kernels for too.
"""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from wobblesim.commands import main

STUDY = """
name: three
seeds: 0..2
robot:
  kind: custom
  nodes: [{position: [0, 0]}, {position: [40, 0]}, {position: [20, 30]}]
  springs:
    - {between: [0, 1], stiffness: 3000}
    - {between: [1, 2], stiffness: 3000}
    - {between: [2, 0], stiffness: 3000}
  muscles: [{spring: 0, group: 0}, {spring: 1, group: 1}]
scene: {floor: null}
physics: {integrator: impulse, dt: 0.005, precision: float64}
trial: {duration: 0.5}
learning: {epochs: 6}
conditions:
  fixed: {wobble: null}
  mass: {wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 3}}
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in an empty folder with a configuration."""
    monkeypatch.chdir(tmp_path)
    Path("three.yaml").write_text(STUDY)


def call(*arguments: str):
    return CliRunner().invoke(main, list(arguments))


def explain(*arguments: str):
    return call("explain", *arguments, "--threads", "1", "--seconds", "0.2")


def rows(text):
    return {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}


def test_it_says_what_is_compiled_in_and_what_the_sweep_needs():
    found = explain("three.yaml")
    assert found.exit_code == 0, found.output
    assert "timing each term" in found.stderr
    line = rows(found.stdout)
    assert line["gravity"][1:3] == line["muscles"][1:3] == ["compiled", "in"]
    for name in ("floor", "friction", "restitution", "recording"):
        assert line[name][1:3] == ["left", "out"], name
    assert " ".join(line["damping"][1:6]) == "no code of its own"
    # 3 seeds x 6 epochs x 20; 5 kept in 5 of 6 epochs, and from epoch 3, the first of the adult, to 5 in 2 of 6
    assert line["fixed"][1:8] == ["3", "0", "3", "360", "285", "75", "20.8"]
    assert line["mass"][1:8] == ["3", "0", "3", "360", "330", "30", "8.3"]
    assert line["fixed"][8] == f"{285 * 100:,}"
    assert {"time", "memory", "disk"} <= line.keys()
    assert "results/three: 0 of 6 runs there" in found.stdout
    assert not Path("results").exists()


def test_json_has_all_of_it():
    found = explain("three.yaml", "--json", "--seeds", "0..3")
    data = json.loads(found.stdout)
    (scene,) = data["scenes"]
    assert scene["conditions"] == ["fixed", "mass"]
    costs = scene["costs"]
    assert costs["lane_step"] > 0
    terms = {term["name"]: term for term in costs["terms"]}
    assert terms["friction"]["cost"] is None
    for name in ("gravity", "floor", "muscles", "recording"):
        assert terms[name]["percent"] == pytest.approx(100 * terms[name]["cost"] / costs["lane_step"])
    assert [work["missing"] for work in data["work"]] == [4, 4]
    assert all(work["simulated"] == work["trials"] - work["reused"] for work in data["work"])
    assert data["seconds"] == pytest.approx(sum(work["physics"] + work["learning"] for work in data["work"]))
    assert all(work["physics"] > 0 and work["learning"] > 0 for work in data["work"])
    memory = data["memory"]
    assert memory["total"] == memory["program"] + memory["trials"] + memory["tables"]
    assert data["disk"]["results"] > 6 * 1000  # a Parquet file of a run has more than 1 kB of settings alone


def test_what_a_sweep_has_done_takes_the_disk_foreseen_and_is_not_counted_again():
    foreseen = json.loads(explain("three.yaml", "--json").stdout)["disk"]["results"]
    assert call("sweep", "three.yaml", "--threads", "1", "--progress", "none").exit_code == 0
    written = sum(path.stat().st_size for path in Path("results/three").rglob("*") if path.is_file())
    pictures = sum(path.stat().st_size for path in Path("results/three/figures").iterdir())
    assert 0.5 < foreseen / (written - pictures) < 2.0  # measured 0.98

    data = json.loads(explain("three.yaml", "--json", "--seeds", "0..6").stdout)
    assert [(work["wanted"], work["present"], work["missing"]) for work in data["work"]] == [(7, 3, 4)] * 2

    done = explain("three.yaml")
    assert rows(done.stdout)["fixed"][1:7] == ["3", "3", "0", "0", "0", "0"]
    assert "results/three: 6 of 6 runs there" in done.stdout

    other = explain("three.yaml", "--set", "trial.duration=1")
    assert other.exit_code == 0
    assert "note: a sweep would be refused: results/three holds results of other settings" in other.stderr


def test_a_wrong_configuration_is_refused_with_its_place():
    Path("wrong.yaml").write_text("name: wrong\nphysics: {integrater: midpoint}\n")
    found = explain("wrong.yaml")
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr.startswith("wrong.yaml:2:11: physics.integrater: unknown key")


@pytest.mark.parametrize(
    "options",
    [["--threads", "0"], ["--seconds", "0"], ["--set", "physics.integrator=explicit", "--set", "physics.dt=1"]],
)
def test_what_cannot_be_run_is_refused(options):
    found = call("explain", "three.yaml", *options)
    assert (found.exit_code, found.stdout) == (2, "")
    assert "Traceback" not in found.output
