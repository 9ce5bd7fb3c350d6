"""Which runs are chosen, and that a replay is a page, a film, or a frame in a notebook."""

import html
import re

import numpy as np
import pytest
from study.toy import study, toy

from wobblesim.analysis.tables import load
from wobblesim.study.errors import StoreError, WriteError
from wobblesim.study.execute import sweep
from wobblesim.viewing.replay import choose, replay

LONGER = "conditions.longer={wobble: {dimension: mass, amplitude: 0.2, period: 5, end: 9}}"


def results_of(folder, *settings, seeds=None):
    sweep(study("log=epochs", *settings, seeds=seeds), folder, simulate=toy)
    return load(folder)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Three conditions, five seeds, of a task that takes no time."""
    return results_of(tmp_path_factory.mktemp("toy"), LONGER, seeds="0..4")


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    """Real robots, two conditions and two seeds."""
    folder = tmp_path_factory.mktemp("robots")
    sweep(study("learning.epochs=3", "trial.duration=1", "conditions.mass.wobble.end=2", seeds="0..1"), folder)
    return folder


def scores(results):
    return results.runs().pivot(index="seed", columns="condition", values="performance")


def test_the_best_is_the_run_with_the_highest_performance(results):
    found, table = choose(results, best=True), scores(results)
    ((condition, seed),) = found
    assert table.loc[seed, condition] == np.nanmax(table.to_numpy())
    ((condition, seed),) = choose(results, "fixed")
    assert (condition, seed) == ("fixed", int(table["fixed"].idxmax()))
    ((condition, seed),) = choose(results, seed=2, best=True)
    assert (condition, seed) == (str(table.loc[2].idxmax()), 2)
    assert choose(results, "mass", 3) == choose(results, "mass", 3, best=True) == [("mass", 3)]


def test_a_pair_is_the_fixed_robot_and_the_condition_with_the_best_mean_with_the_same_seed(results):
    table = scores(results)
    other = str(table[["mass", "longer"]].mean().idxmax())
    (fixed, seed), (wobbling, same) = choose(results, pair=True)
    assert (fixed, wobbling, seed) == ("fixed", other, same)
    difference = (table[other] - table["fixed"]).dropna()
    if len(difference) % 2:
        assert difference[seed] == np.median(difference)
    assert choose(results) == choose(results, pair=True)
    assert choose(results, seed=1) == [("fixed", 1), (other, 1)]
    assert choose(results, "longer", 1, pair=True) == [("fixed", 1), ("longer", 1)]


def test_of_an_even_number_of_seeds_the_first_beside_the_median_is_taken(tmp_path):
    results = results_of(tmp_path, seeds="0..3")
    (_, seed), (other, _) = choose(results, pair=True)
    difference = (scores(results)[other] - scores(results)["fixed"]).dropna()
    distance = (difference - difference.median()).abs()
    assert distance[seed] == distance.min()
    assert seed == min(distance.index[distance == distance.min()])


def test_without_a_condition_named_fixed_the_best_is_shown_and_the_first_is_paired_if_asked_for(tmp_path):
    sweep(study("sweep.learning.scale=0.01,0.1", "conditions={}", "log=epochs", seeds="0..1"), tmp_path, simulate=toy)
    results = load(tmp_path)
    assert len(choose(results)) == 1
    assert [condition for condition, _ in choose(results, pair=True)] == results.conditions


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ({"condition": "lnger"}, r"no condition 'lnger' \(did you mean 'longer'\?\); choose among fixed, mass, longer"),
        ({"condition": "fixed", "pair": True}, "fixed is what others are compared with, and no pair with itself"),
        ({"seed": 9, "best": True}, r"has no run with seed 9; choose among seeds 0\.\.4"),
    ],
)
def test_what_cannot_be_chosen_is_said_in_a_sentence(results, chosen, said):
    with pytest.raises(StoreError, match=said):
        choose(results, **chosen)


def test_both_the_best_and_a_pair_are_refused(results):
    with pytest.raises(ValueError, match="either"):
        choose(results, best=True, pair=True)


def test_a_study_of_one_condition_has_no_pair(tmp_path):
    sweep(study("conditions={}", "log=epochs", seeds="0..1"), tmp_path, simulate=toy)
    results = load(tmp_path)
    assert len(choose(results)) == 1
    with pytest.raises(StoreError, match="and nothing to pair it with; use --best"):
        choose(results, pair=True)


def test_runs_without_a_score_are_neither_the_best_nor_in_a_pair(results, monkeypatch):
    from wobblesim.analysis.tables import Results

    runs = results.runs("condition", "seed", "performance")
    lost = runs.assign(performance=np.nan)
    monkeypatch.setattr(Results, "runs", lambda self, *columns: lost)
    for chosen in ({"best": True}, {"condition": "mass"}):
        with pytest.raises(
            StoreError, match=r"no such run of .* has a score, for all trials of its last epoch diverged"
        ):
            choose(results, **chosen)
    with pytest.raises(StoreError, match=r"no seed of .* has a score both in fixed and in mass"):
        choose(results)
    only = runs.assign(performance=runs["performance"].where(runs["seed"] == 3))
    monkeypatch.setattr(Results, "runs", lambda self, *columns: only)
    assert [seed for _, seed in choose(results)] == [3, 3]


def test_a_replay_of_a_folder_and_of_its_results_are_the_same_page(robots):
    found = replay(robots)
    assert [it.condition for it in found.recordings] == ["fixed", "mass"]
    assert replay(load(robots)).html == found.html
    assert repr(found) == f"<Replay of fixed against mass, seed {found.recordings[0].seed}, epoch 2>"


def test_a_notebook_shows_the_page_in_a_frame_that_reaches_nothing(robots):
    found = replay(robots, condition="mass", seed=1)
    shown = found._repr_html_()
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1]) == found.html
    assert 'sandbox="allow-scripts"' in shown
    assert found.name == "mass_seed-1_epoch-2"


def test_the_frame_of_a_notebook_plays(browser, robots, tmp_path):
    path = tmp_path / "notebook.html"
    path.write_text(f"<!doctype html><meta charset=utf-8>{replay(robots)._repr_html_()}", encoding="utf-8")
    with browser.page(path) as page:
        page.wait("document.querySelector('iframe').clientHeight > 400")
        assert page.in_frame("document.querySelector('.wobble-player').player.duration") == 1.0
        told = "player.unpack().then(() => document.querySelector('.wp-distance').textContent)"
        assert page.in_frame(f"document.querySelector('.wobble-player').{told}").endswith(" body lengths")


def test_a_replay_is_saved_whole_in_a_folder_made_for_it(robots, tmp_path):
    found = replay(robots)
    path = found.save(tmp_path / "a" / "b" / "page.html")
    assert path.read_text(encoding="utf-8") == found.html
    assert found.save(tmp_path / "film.GIF", seconds=0.2).read_bytes()[:6] == b"GIF89a"
    assert sorted(it.name for it in tmp_path.iterdir()) == ["a", "film.GIF"]
    assert [it.name for it in (tmp_path / "a" / "b").iterdir()] == ["page.html"]


def test_other_ends_of_names_are_refused_and_a_folder_that_cannot_be_made_is_told_of(robots, tmp_path):
    found = replay(robots, best=True)
    with pytest.raises(StoreError, match=r"x\.avi does not end in \.html, \.gif or \.mp4"):
        found.save(tmp_path / "x.avi")
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match=r"cannot write .*x\.html: not a directory"):
        found.save(tmp_path / "file" / "x.html")


def test_names_of_files_are_short_enough_for_any_system(robots):
    from dataclasses import replace

    first, second = replay(robots).recordings
    long = [replace(first, condition="a" * 240), replace(second, condition="a" * 239 + "b")]
    name = type(replay(robots))(tuple(long)).name
    assert len(name) < 170
    one, other = name.split("_")[0].split("-against-")
    assert one != other
