"""`wobblesim replay`: a page or a film of what was learnt, exit code 2 and a sentence where there is none."""

import json
import re

import pytest
from click.testing import CliRunner
from study.toy import study

from wobblesim.commands import main
from wobblesim.study.execute import sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two conditions of a small robot, two seeds."""
    folder = tmp_path_factory.mktemp("robots")
    sweep(study("learning.epochs=3", "trial.duration=1", "conditions.mass.wobble.end=2", seeds="0..1"), folder)
    return folder


def call(*arguments):
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


def test_a_page_of_the_pair_goes_beside_the_results(results):
    found = call(results, "--seed", 1)
    assert found.exit_code == 0, found.output
    path = results / "replays" / "fixed-against-mass_seed-1_epoch-2.html"
    size = path.stat().st_size / 1e6
    first, _, head, _, fixed, mass, *_ = found.stdout.splitlines()
    assert first == f"{path} ({size:.2f} MB)"
    assert head.split() == ["condition", "seed", "epoch", "body", "lengths", "trial"]
    assert fixed.split()[:3] == ["fixed", "1", "2"]
    assert re.fullmatch(r"mass +1 +2 +-?\d\.\d{3} +1 s", mass.strip())
    assert path.read_text(encoding="utf-8").startswith("<!doctype html>")


def test_json_has_the_numbers_of_the_table_of_runs(results):
    from wobblesim.analysis.tables import load

    found = json.loads(call(results, "--condition", "mass", "--seed", 0, "--json").stdout)
    stored = load(results).runs().query("condition == 'mass' and seed == 0")["performance"].item()
    assert found["file"].endswith("mass_seed-0_epoch-2.html")
    (robot,) = found["robots"]
    assert robot["performance"] == robot["stored"] == stored
    assert robot["same_bits"] is True
    assert (robot["condition"], robot["seed"], robot["epoch"], robot["frames"]) == ("mass", 0, 2, 26)


def test_a_film_shows_as_much_as_was_asked_for(results, tmp_path):
    from PIL import Image

    found = call(results, "--best", "--epoch", 1, "--out", tmp_path / "best.gif", "--seconds", 0.4, "--fps", 10)
    assert found.exit_code == 0, found.output
    assert "The first 0.4 s of a trial of 1 s." in found.stdout
    with Image.open(tmp_path / "best.gif") as film:
        assert film.n_frames == 5


def test_the_rate_of_a_page_is_that_of_its_frames(results, tmp_path):
    found = call(results, "--best", "--fps", 10, "--out", tmp_path / "x.html", "--json")
    assert json.loads(found.stdout)["robots"][0]["frames"] == 11


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--condition", "mas"], r"has no condition 'mas' \(did you mean 'mass'\?\); choose among fixed, mass\n"),
        (["--seed", "7"], r"has no seed 7 of fixed; choose among seeds 0\.\.1\n"),
        (["--epoch", "5"], r"has no epoch 5; choose one from 0 to 2\n"),
        (
            ["--out", "film.avi"],
            r"film\.avi does not end in \.html, \.gif or \.mp4, which is what can be written; .*\n",
        ),
        (["--best", "--pair"], r"--best is one run and --pair are two: give one of them\n"),
        (["--seconds", "0"], r"is not in the range x>0\.?.*\n"),
    ],
)
def test_what_is_not_there_is_exit_code_2_and_a_sentence(results, arguments, said):
    found = call(results, *arguments)
    assert (found.exit_code, found.stdout) == (2, "")
    assert re.search(said, found.stderr)


def test_without_ffmpeg_no_trial_is_simulated_and_a_sentence_says_what_to_do(results, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    found = call(results, "--out", tmp_path / "film.mp4")
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr.startswith("MP4 is made by ffmpeg, and no ffmpeg is on the PATH; install it")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_results_is_exit_code_2(tmp_path):
    found = call(tmp_path)
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr == f"{tmp_path} holds no results; give the folder that a sweep has written\n"


def test_another_performance_is_told_by_how_much(results, monkeypatch):
    import dataclasses

    from wobblesim.viewing import replay

    record = replay.record

    def altered(*arguments, **settings):
        return dataclasses.replace(record(*arguments, **settings), stored=1.0, performance=1.25)

    monkeypatch.setattr(replay, "record", altered)
    found = call(results, "--condition", "mass", "--seed", 0)
    assert found.exit_code == 0
    assert "it comes to 1.25 body lengths, stored is 1 body lengths, a difference of 0.25.\n" in found.stdout
