"""The report: its numbers are those of the results, it runs its own scripts only, and it says what is missing."""

import base64
import io
import json
import re

import numpy as np
import pandas as pd
import pytest
from study.toy import StopAfter, outcome, study, toy

from wobblesim.analysis.comparison import compare
from wobblesim.analysis.export import flat
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.figures.style import Drawing, new_figure
from wobblesim.analysis.tables import load
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest
from wobblesim.viewing import report as module
from wobblesim.viewing.recording import record
from wobblesim.viewing.report import SECTIONS, headline_of, report

NUMBERS = """
(section) => [...document.querySelectorAll(`#${section} td[data-name][data-value]`)].map((cell) => [
  cell.closest("tr").dataset.row, cell.dataset.name, cell.dataset.value, cell.textContent,
])
"""

CONTRAST = """
() => {
  const channel = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (color) => {
    const [r, g, b] = color.match(/[\\d.]+/g).map(Number);
    return 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  };
  const under = (element) => {
    for (let it = element; it; it = it.parentElement) {
      const color = getComputedStyle(it).backgroundColor;
      if (color !== "rgba(0, 0, 0, 0)") return color;
    }
  };
  const words = "h1, h2, p, td, th, caption, dt, dd, a:not(.skip), summary, figcaption, li, code, .chip, footer";
  return Math.min(...[...document.querySelectorAll(words)].map((it) => {
    const pair = [light(getComputedStyle(it).color), light(under(it))].sort((a, b) => b - a);
    return (pair[0] + 0.05) / (pair[1] + 0.05);
  }));
}
"""


def diverging(body, behaviours, **_):
    """Every trial diverges."""
    return outcome(np.zeros(len(behaviours)), diverged=np.ones(len(behaviours), dtype=bool))


def phased(body, behaviours, *, morphology, **_):
    """A toy whose best behaviour depends on the mass, so that conditions differ in the end."""
    half = behaviours.shape[1] // 2
    turns = behaviours[:, half:] * morphology.mass + behaviours[:, :half]
    return outcome(np.cos(2 * np.pi * turns).sum(axis=1), diverged=behaviours[:, 0] > 0.92)


REAL = ("boxes", "figure-3a", "heat-map")


def quick_draw(name, results, choice):
    """Figures have tests of their own: all but a few are empty here."""
    if name in REAL:
        return draw(name, results, choice)
    return Drawing(new_figure(2, 1), pd.DataFrame({"figure": [name], "number": [0.1]}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("secret-place") / "study-x"
    sweep(study("trial.duration=1"), folder, simulate=phased)
    return folder


@pytest.fixture(scope="module")
def made(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "draw", quick_draw)
        return report(folder)


@pytest.fixture(scope="module")
def page(made, folder):
    return made.save(folder / "report.html")


@pytest.fixture
def no_figures(monkeypatch):
    """A page without the figures, which is made sooner."""
    monkeypatch.setattr(module, "SECTIONS", dict.fromkeys(SECTIONS, ()))


# --- what it says --------------------------------------------------------------------------------------------------


def test_the_numbers_in_the_page_are_those_of_the_comparison_bit_for_bit(browser, page, folder):
    found = compare(load(folder))
    with browser.page(page) as it:
        seen = it.evaluate(NUMBERS, "statistics") + it.evaluate(NUMBERS, "trials")
    expected = found.conditions.set_index("condition").join(found.pairs.set_index("condition"))
    assert {(row, name) for row, name, _, _ in seen} >= {("mass", "p_holm"), ("fixed", "mean"), ("mass", "diverged")}
    for row, name, value, _ in seen:
        assert float(value) == pytest.approx(float(expected.loc[row, name]), rel=0, abs=0, nan_ok=True)


def test_a_reader_sees_the_same_numbers_rounded(browser, page):
    with browser.page(page) as it:
        seen = {(row, name): (float(value), text) for row, name, value, text in it.evaluate(NUMBERS, "statistics")}
    for (_, name), (value, text) in seen.items():
        if text != "–" and name in ("mean", "median", "difference", "effect"):
            assert float(re.match(r"[-+]?[\d.]+", text)[0]) == pytest.approx(value, abs=0.0051)  # two digits, 0.005


def test_the_headline_is_the_difference_that_comparing_finds(browser, page, made, folder):
    found = compare(load(folder)).pairs.iloc[0]
    with browser.page(page) as it:
        assert it.text(".headline") == made.headline
    assert made.headline.startswith("mass: ")
    assert f"{abs(found['difference']):.2f} {'more' if found['difference'] > 0 else 'less'} than fixed" in made.headline
    assert f"(4 pairs, Wilcoxon p = {found['p_holm']:#.3g}, not significant at 0.01)" in made.headline


def test_of_many_conditions_the_headline_counts_those_that_differ(folder):
    found = compare(load(folder))
    row = found.pairs.iloc[0]
    pairs = pd.DataFrame([row, row, row]).assign(
        condition=["a", "b", "c"], difference=[0.5, -0.25, 0.1], p=[0.001, 0.002, 0.5], p_holm=[0.003, 0.004, 0.5],
        significant=[True, True, False],
    )  # fmt: skip
    mine = found.conditions.iloc[1]
    conditions = pd.DataFrame([found.conditions.iloc[0], mine, mine, mine]).assign(
        condition=["fixed", "a", "b", "c"], mean=[1.0, 1.5, 0.75, 1.1]
    )
    many = type(found)(conditions, pairs, found.missing, "fixed", 0.01, ())
    assert headline_of(many, "body lengths in 1 s") == (
        "Of 3 conditions, 1 did significantly better than fixed, 1 worse (Wilcoxon, Holm-corrected, p < 0.01).",
        "Highest mean: a: 1.50 body lengths in 1 s, 0.50 more than fixed "
        "(4 pairs, Wilcoxon p = 0.00300, Holm-corrected for 3 tests, significant at 0.01).",
    )


@pytest.mark.parametrize(
    ("difference", "words"),
    [(0.234, "0.23 more than"), (-1.5, "1.50 less than"), (-0.00123, "0.0012 less than"), (0.0, "as much as")],
)
def test_a_difference_is_never_rounded_to_nothing(difference, words):
    assert module._more(difference) == words


def test_the_table_behind_a_figure_can_be_saved_and_has_every_number(browser, page, folder):
    with browser.page(page) as it:
        links = dict(it.evaluate("[...document.querySelectorAll('a[download]')].map((a) => [a.download, a.href])"))
    for name, table in (
        ("boxes", draw("boxes", load(folder), Choice(baseline="fixed")).table),
        ("statistics", flat(compare(load(folder)))),
    ):
        content = base64.b64decode(links[f"{name}.csv"].partition("base64,")[2]).decode()
        assert content == table.to_csv(index=False, lineterminator="\n")
        assert len(pd.read_csv(io.StringIO(content))) == len(table)


def test_settings_that_differ_are_in_the_table_and_others_are_not(browser, page):
    with browser.page(page) as it:
        head = it.texts("#conditions table:not(.words) thead th")
        assert it.texts("#conditions tr[data-row=mass] td[data-name='wobble.period']") == ["5"]
    assert {"wobble.dimension", "wobble.period", "wobble.end"} < set(head)
    assert not {"trial.duration", "robot.arms"} & set(head)


def test_what_computed_the_runs_is_what_their_files_say(browser, page, folder):
    about = module.read_about(folder / read_manifest(folder).files("runs")[0].path)
    with browser.page(page) as it:
        for name in ("version", "git", "kernel", "numba", "cpu"):
            assert it.texts(f"#provenance td[data-name={name}]") == [" ".join(about[name].split()) or "–"]
        assert (
            it.evaluate("document.querySelector('#provenance details code').textContent")
            == (folder / "config.yaml").read_text()
        )


def test_nothing_in_the_page_says_where_the_folder_lies(made, folder):
    assert "secret-place" not in made.html
    assert "study-x" in made.html


def test_the_same_results_make_the_same_page(no_figures, folder):
    assert report(folder, simulate=False).html == report(folder, simulate=False).html


def test_figures_that_the_study_has_no_data_for_say_so(browser, page, made):
    with browser.page(page) as it:
        said = {
            name: it.evaluate(f"document.querySelector('[data-absent={name}]').textContent")
            for name in made.left_out
        }  # fmt: skip
        shown = it.evaluate("[...document.querySelectorAll('figure')].map((figure) => figure.id)")
    assert {"figure-3a", "heat-map"} <= said.keys()
    assert all(made.left_out[name].rstrip(".") in text for name, text in said.items())
    assert tuple(shown) == made.figures
    assert set(shown) | said.keys() >= {name for names in SECTIONS.values() for name in names}


def test_another_baseline_is_what_others_are_compared_with(no_figures, folder):
    made = report(folder, baseline="mass", simulate=False)
    assert "than mass" in made.headline
    with pytest.raises(StoreError, match="did you mean mass"):
        report(folder, baseline="mas")


# --- how it looks --------------------------------------------------------------------------------------------------


def test_light_and_dark_differ_and_both_can_be_read(browser, page):
    backgrounds = {}
    for scheme in ("light", "dark"):
        with browser.page(page, scheme=scheme) as it:
            backgrounds[scheme] = it.evaluate("getComputedStyle(document.body).backgroundColor")
            # WCAG 2.1 AA asks for 4.5; measured 6.1 light, 6.2 dark
            assert it.evaluate(CONTRAST) > 4.5
            cards = it.evaluate(
                "[...document.querySelectorAll('.card')].map((c) => getComputedStyle(c).backgroundColor)"
            )
            assert set(cards) == {"rgb(255, 255, 255)"}
    assert backgrounds == {"light": "rgb(250, 251, 252)", "dark": "rgb(14, 17, 20)"}


def test_a_telephone_scrolls_tables_within_their_box_and_never_the_page(browser, page):
    with browser.page(page, width=375, height=700) as it:
        it.evaluate("document.querySelectorAll('details').forEach((it) => { it.open = true; })")
        assert it.evaluate("document.documentElement.scrollWidth") <= 375
        assert it.evaluate("[...document.querySelectorAll('.scroll')].some((it) => it.scrollWidth > it.clientWidth)")


def test_names_are_unique_pictures_load_and_every_link_leads_somewhere(browser, page):
    with browser.page(page) as it:
        ids = it.evaluate("[...document.querySelectorAll('[id]')].map((element) => element.id)")
        assert len(ids) == len(set(ids))
        assert it.evaluate("[...document.images].every((it) => it.complete && it.naturalWidth > 0 && it.alt)")
        assert it.evaluate(
            "[...document.querySelectorAll('a[href^=\"#\"]')].every((a) => document.getElementById(a.hash.slice(1)))"
        )
        assert it.evaluate(
            "[...document.querySelectorAll('section')].every((it) => it.getAttribute('aria-labelledby'))"
        )


def test_all_players_show_their_robots(browser, page):
    with browser.page(page) as it:
        robots = it.evaluate(
            "Promise.all([...document.querySelectorAll('[data-player]')].map(async (element) => {"
            "  await element.player.unpack();"
            "  return [element.id, element.querySelectorAll('canvas').length, element.player.positions(0, 0).length];"
            "}))"
        )
    nodes = record(load(page.parent), "fixed", 0, seconds=0.1).body.n_nodes
    assert [player[:2] for player in robots] == [["player-pair", 2], ["player-best", 2]]
    assert [player[2] for player in robots] == [2 * nodes, 2 * nodes]


# --- names that would be scripts -----------------------------------------------------------------------------------


def test_a_name_cannot_become_a_script(browser, no_figures, tmp_path):
    hostile = "<img src=x onerror=document.title='bad'>"
    sweep(study("trial.duration=1", seeds="0..1"), tmp_path / hostile, simulate=toy)
    text = (tmp_path / hostile / "config.yaml").read_text()
    (tmp_path / hostile / "config.yaml").write_text(
        text.replace("name: toy", "name: \"</title><script>document.title='bad'</script>{{ 7 * 7 }}\"")
    )
    made = report(tmp_path / hostile, simulate=False)
    with browser.page(made.save(tmp_path / "out.html")) as it:
        assert it.evaluate("document.title") == "</title><script>document.title='bad'</script>{{ 7 * 7 }}: report"
        assert it.evaluate("document.querySelectorAll('img:not(.card img), script').length") == 2
        assert hostile in it.text("footer")


def test_the_policy_refuses_a_script_that_is_not_ours(browser, page, tmp_path):
    """Also if a name were not escaped, it would not run."""
    foreign = tmp_path / "foreign.html"
    foreign.write_text(page.read_text().replace("</footer>", "</footer><script>document.title = 'bad'</script>"))
    with pytest.raises(AssertionError, match="Content Security Policy"), browser.page(foreign) as it:
        assert it.evaluate("document.title") == "toy: report"


# --- studies that lack something -----------------------------------------------------------------------------------


def test_a_study_whose_runs_all_diverged_has_a_page_that_says_so(browser, no_figures, tmp_path):
    sweep(study("trial.duration=1", seeds="0..1"), tmp_path / "lost", simulate=diverging)
    made = report(tmp_path / "lost")
    assert made.headline == "No run has a score: in each, all trials of the last epoch diverged."
    with browser.page(made.save(tmp_path / "out.html")) as it:
        assert it.text("[data-tile=excluded]") == "4"
        assert "no best robot" in it.text("[data-absent=player-best]")


def test_an_unfinished_sweep_is_shown_as_far_as_it_is_with_the_runs_that_are_missing(browser, no_figures, tmp_path):
    sweep(study("trial.duration=1", seeds="0..1"), tmp_path / "work", simulate=toy)
    sweep(study("trial.duration=1"), tmp_path / "work", simulate=toy, stop=StopAfter(1))
    assert len(read_manifest(tmp_path / "work").runs) == 4
    made = report(tmp_path / "work", simulate=False)
    with browser.page(made.save(tmp_path / "out.html")) as it:
        assert it.text("[data-tile=finished]") == "4 of 8"
        assert it.evaluate("document.querySelector('[data-missing]').dataset.missing") == "4"
        assert "made without robots" in it.text("#robots")


def test_one_run_is_a_study_too(no_figures, tmp_path):
    sweep(
        study("trial.duration=1", "conditions={only: {wobble: null}}", "log=epochs", seeds="3"), tmp_path, simulate=toy
    )
    made = report(tmp_path)
    performance = load(tmp_path).runs("performance")["performance"].iloc[0]
    assert made.headline == f"only: {performance:.2f} body lengths in 1 s (1 run)."
    assert (
        json.loads(re.search(r'id="player-best-data">(.*?)</script>', made.html)[1])["robots"][0]["condition"] == "only"
    )


def test_a_notebook_shows_the_page_in_a_frame_that_reaches_nothing(made):
    shown = made._repr_html_()
    assert shown.startswith("<iframe")
    assert "allow-same-origin" not in shown
    assert made.html.count("<") > 1000 > shown.count("<")
