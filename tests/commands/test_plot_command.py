"""`wobblesim plot` as a user meets it: files and reasons, names and choices, exit codes."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from study.toy import study, toy

from wobblesim.analysis.figures.registry import FIGURES
from wobblesim.commands import main
from wobblesim.study.execute import sweep


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A study with all tables."""
    folder = tmp_path_factory.mktemp("kept")
    sweep(study(), folder, simulate=toy)
    return folder


@pytest.fixture(scope="module")
def epochs_only(tmp_path_factory):
    """A study whose log is epochs."""
    folder = tmp_path_factory.mktemp("epochs")
    sweep(study("log=epochs"), folder, simulate=toy)
    return folder


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)


def call(*arguments):
    return CliRunner().invoke(main, ["plot", *map(str, arguments)])


def rows(path):
    return list(csv.DictReader(Path(path).read_text().splitlines()))


def names(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def test_a_figure_is_three_pictures_and_a_table_beside_the_results(kept):
    found = call(kept, "boxes")
    assert (found.exit_code, found.stderr) == (0, "")
    assert found.stdout.split() == [str(kept / "figures" / f"boxes.{form}") for form in ("png", "svg", "pdf", "csv")]
    starts = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF"}
    for form, start in starts.items():
        assert (kept / "figures" / f"boxes.{form}").read_bytes().startswith(start)
    assert [row["condition"] for row in rows(kept / "figures" / "boxes.csv")] == ["fixed", "mass"]
    assert names(kept / "figures") == ["boxes.csv", "boxes.pdf", "boxes.png", "boxes.svg"]


def test_formats_and_place_are_chosen(kept):
    found = call(kept, "figure-4b", "--format", "svg", "--out", "paper/pictures")
    assert found.stdout.split() == ["paper/pictures/figure-4b.svg", "paper/pictures/figure-4b.csv"]
    assert names("paper/pictures") == ["figure-4b.csv", "figure-4b.svg"]


def test_the_same_figure_is_the_same_bytes_the_second_time(kept):
    for out in ("one", "two"):
        assert call(kept, "figure-4a", "--format", "svg", "--out", out).exit_code == 0
    for name in names("one"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()


def test_of_a_group_what_can_be_drawn_is_drawn_and_the_others_say_why(epochs_only):
    found = call(epochs_only, "figure-2", "figure-4", "--format", "png", "--out", "out")
    assert found.exit_code == 0
    assert sorted(Path(line).name for line in found.stdout.split() if line.endswith("png")) == [
        "figure-2b.png", "figure-4b.png"
    ]  # fmt: skip
    said = found.stderr.splitlines()
    assert len(said) == 2
    assert said[0].startswith("figure-2a: every trial is a dot, and fixed and mass kept none; set `log: trials`")
    assert said[1].startswith("figure-4a: behaviours are shown as points, and fixed and mass kept none")


def test_a_figure_that_is_named_and_cannot_be_drawn_is_exit_code_2(epochs_only):
    found = call(epochs_only, "figure-3a", "boxes", "--format", "png", "--out", "out")
    assert found.exit_code == 2
    assert found.stderr == (
        "figure-3a: wobble.period does not vary among the conditions shown; draw `boxes` for them as they are\n"
    )
    assert Path("out/boxes.png").exists()


def test_a_group_of_which_nothing_can_be_drawn_is_exit_code_2(epochs_only):
    found = call(epochs_only, "figure-3", "--out", "out")
    assert (found.exit_code, found.stdout, len(found.stderr.splitlines())) == (2, "", 3)
    assert not Path("out").exists()


def test_an_unknown_name_is_refused_with_the_nearest(kept):
    found = call(kept, "figure-3d")
    assert found.exit_code == 2
    assert re.fullmatch(r"there is no figure 'figure-3d'; did you mean figure-3\w?\?\n", found.stderr)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--condition", "masss"], "has no condition 'masss'; did you mean mass?"),
        (["--baseline", "fixd"], "has no condition 'fixd'; did you mean fixed?"),
        (["--seed", "9"], "figure-2a: {} has no run of fixed with seed 9; the nearest is 3"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(kept, options, said):
    found = call(kept, "figure-2a", "--out", "out", *options)
    assert (found.exit_code, found.stderr.count("\n")) == (2, 1)
    assert said.format(kept) in found.stderr


def test_conditions_baseline_and_seed_reach_the_figure(kept):
    call(kept, "figure-2a", "--condition", "mass", "--seed", "3", "--format", "svg", "--out", "out")
    assert {(row["condition"], row["seed"]) for row in rows("out/figure-2a.csv")} == {("mass", "3")}
    call(kept, "boxes", "--baseline", "mass", "--format", "svg", "--out", "out")
    assert [row["p_holm"] == "" for row in rows("out/boxes.csv")] == [False, True]


def test_json_says_files_and_reasons(epochs_only):
    found = call(epochs_only, "figure-2", "--format", "png", "--out", "out", "--json")
    told = {figure["name"]: figure for figure in json.loads(found.stdout)["figures"]}
    assert told["figure-2b"] == {
        "name": "figure-2b", "files": ["out/figure-2b.png", "out/figure-2b.csv"], "reason": None
    }  # fmt: skip
    assert told["figure-2a"]["files"] == []
    assert told["figure-2a"]["reason"].startswith("every trial is a dot")


def test_the_list_says_what_each_figure_shows_and_what_the_study_lacks(epochs_only):
    found = call(epochs_only, "--list", "figure-2", "boxes")
    assert (found.exit_code, found.stderr) == (0, "")
    assert re.search(rf"figure-2a +{FIGURES['figure-2a'].says} +every trial is a dot", found.stdout)
    assert re.search(rf"figure-2b +{FIGURES['figure-2b'].says}\n", found.stdout)
    told = json.loads(call(epochs_only, "--list", "figure-2", "boxes", "--json").stdout)["figures"]
    assert [(row["name"], row["reason"] is None) for row in told] == [
        ("figure-2a", False), ("figure-2b", True), ("boxes", True)
    ]  # fmt: skip
    assert not (epochs_only / "figures").exists()


def test_a_folder_without_results_is_refused():
    found = call("nowhere")
    assert (found.exit_code, found.stderr.count("\n")) == (2, 1)
    assert "nowhere holds no results" in found.stderr


def test_a_picture_that_cannot_be_written_is_exit_code_1(kept):
    Path("taken").write_text("a file")
    found = call(kept, "boxes", "--out", "taken/pictures")
    assert found.exit_code == 1
    assert re.fullmatch(r"cannot write taken/pictures: .*\n", found.stderr)


def test_a_table_that_is_altered_keeps_its_figures_from_being_drawn(kept, tmp_path):
    folder = tmp_path / "altered"
    shutil.copytree(kept, folder)
    path = next((folder / "trials").rglob("*.parquet"))
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    found = call(folder, "figure-2a", "--seed", re.search(r"\d+", path.stem)[0])
    assert found.exit_code == 2
    assert path.name in found.stderr
    assert "verify" in found.stderr
