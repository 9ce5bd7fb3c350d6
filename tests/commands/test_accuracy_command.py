"""`wobblesim accuracy`: tables, JSON, files, and bad names refused in one line."""

import functools
import json
import math

import pandas as pd
import pytest
from click.testing import CliRunner

from wobblesim.commands import main
from wobblesim.numerics import accuracy_report

TWO_SCENES = ["--short", "--scene", "drop", "--scene", "gait", "--integrator", "midpoint", "--integrator", "impulse"]


def run(*options):
    return CliRunner().invoke(main, ["accuracy", *options])


@pytest.fixture(scope="module", autouse=True)
def measured_once():
    """What is asked for with the same options as in another test of this module is not measured again."""
    measured = functools.cache(accuracy_report.make_report)

    def make_report(*names, tell, **options):
        return measured(*names, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accuracy_report, "make_report", make_report)
        yield


def test_short_form_writes_rows_pictures_and_a_sentence(tmp_path):
    page = tmp_path / "docs" / "accuracy.md"
    result = run(*TWO_SCENES, "--json", "--out", str(tmp_path / "out"), "--page", str(page))
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert {"cpu", "numba", "numpy", "python", "date"} <= found["conditions"].keys()
    table = pd.read_parquet(tmp_path / "out" / "accuracy.parquet")
    assert len(table) == len(found["rows"])
    assert set(table["scene"]) == {"drop", "gait"}
    gait = table[(table["scene"] == "gait") & (table["morphology"] == "all")].sort_values("dt")
    assert gait.loc[gait["integrator"] == "midpoint", "performance_median"].is_monotonic_increasing
    assert (gait["seconds"] > 0).all()
    assert (gait["performance_median"] <= gait["performance_p95"]).all()
    assert gait["shipped"].sum() == 1
    below = gait[gait["performance_median"] < 0.01]
    assert f"at dt {below.sort_values('seconds')['dt'].iloc[0]:.3g} s" in found["sentence"]
    for picture in (tmp_path / "out", tmp_path / "docs" / "_static"):
        assert (picture / "accuracy.png").stat().st_size > 10_000
        assert (picture / "accuracy.svg").read_text().startswith("<?xml")
    assert found["sentence"] in " ".join(page.read_text(encoding="utf-8").split())  # its lines are broken


def test_tables_fit_100_columns():
    result = run(*TWO_SCENES)
    assert result.exit_code == 0, result.output
    lines = [line for line in result.stdout.splitlines() if line.startswith((" midpoint", " impulse", " setting"))]
    # of each scene a header and three steps of each integrator; of the gait impulse one lane at a time as well
    assert len(lines) == (1 + 3 + 3) + (1 + 3 + 4)
    assert max(map(len, lines)) <= 100
    assert "node (u)" in lines[0]
    assert "node (u)" in lines[7]
    assert any(line.split()[-1] == "0" and "=" in line for line in lines[8:])  # the shipped default, no failures


@pytest.mark.nightly
def test_short_form_of_everything():
    result = run("--short", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert {row["scene"] for row in found["rows"]} == {"oscillator", "chain", "flight", "drop", "gait", "long-gait"}
    assert found["seconds"] < 60
    assert found["goal"]["ratio"] > 1
    assert all(math.isfinite(s["largest"]) for s in found["sensitivity"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scene", "moon"], "'moon' is not one of oscillator, chain"),
        (["--integrator", "euler"], "'euler' is not one of midpoint"),
        (["--threads", "0"], "0 is not in the range"),
    ],
)
def test_options_that_mean_nothing_are_refused_in_one_line(options, said):
    result = run(*options)
    assert result.exit_code == 2
    assert result.stderr.count(said) == 1
    assert "Traceback" not in result.output


def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_measured(tmp_path):
    (tmp_path / "file").write_text("")
    result = run("--out", str(tmp_path / "file" / "deeper"))
    assert result.exit_code == 2
    assert "--out" in result.stderr
