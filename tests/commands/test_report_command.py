"""`wobblesim report`: where the page goes, and what is said of it."""

import json

import pytest
from click.testing import CliRunner
from study.toy import study, toy

from wobblesim.commands import main
from wobblesim.study.execute import sweep
from wobblesim.study.verify import verify
from wobblesim.viewing import report as module


@pytest.fixture(autouse=True)
def one_figure(monkeypatch):
    """A page with one figure, which this study has no data for, is made sooner."""
    names = {name: ("heat-map",) * (name == "performance") for name in module.SECTIONS}
    monkeypatch.setattr(module, "SECTIONS", names)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    sweep(study("trial.duration=1", seeds="0..1"), folder, simulate=toy)
    return folder


def run(*arguments):
    return CliRunner().invoke(main, ["report", *map(str, arguments)])


def test_the_page_goes_into_the_folder_where_verify_lets_it_be(folder):
    found = run(folder, "--no-players")
    assert found.exit_code == 0, found.output
    path = folder / "report.html"
    assert found.stdout == f"{path} ({path.stat().st_size / 1e6:.2f} MB)\n"
    assert found.stderr.splitlines()[-2:] == ["statistics", "heat-map"]
    assert not verify(folder).findings
    assert [file.name for file in folder.glob("report*")] == ["report.html"]


def test_json_says_what_is_in_the_page_and_what_is_not(folder, tmp_path):
    found = run(folder, "--no-players", "--json", "--out", tmp_path / "new" / "page.html", "--baseline", "mass")
    told = json.loads(found.stdout)
    page = tmp_path / "new" / "page.html"
    assert told["file"] == str(page)
    assert told["bytes"] == page.stat().st_size
    assert told["figures"] == []
    assert "wobble.period" in told["left_out"]["heat-map"]
    assert "as much as mass" in told["headline"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--out", "page.pdf"), "does not end in .html"),
        (("--baseline", "nothing"), "has no condition 'nothing'"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_sentence(folder, arguments, sentence):
    found = run(folder, *arguments)
    assert found.exit_code == 2
    assert sentence in found.stderr


def test_a_folder_without_results_is_refused(tmp_path):
    found = run(tmp_path)
    assert found.exit_code == 2
    assert "holds no results" in found.stderr


def test_a_page_that_cannot_be_written_leaves_what_was_there(folder, tmp_path):
    (tmp_path / "file").write_text("mine")
    found = run(folder, "--no-players", "--out", tmp_path / "file" / "page.html")
    assert found.exit_code == 1
    assert "cannot write" in found.stderr
    assert (tmp_path / "file").read_text() == "mine"
