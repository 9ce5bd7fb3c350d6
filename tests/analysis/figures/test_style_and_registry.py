"""What all figures share: the same bytes for the same figure, names, colours, labels, and the list of figures."""

import csv
import importlib
import inspect

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from study.toy import study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.figures.registry import FIGURES, GROUPS, Choice, draw, expand, lacking
from wobblesim.analysis.figures.style import OKABE_ITO, Drawing, as_bytes, count, files_of, looks, new_figure, spread
from wobblesim.analysis.tables import load
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep

STARTS = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    sweep(study(), folder, simulate=toy)
    return load(folder)


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "form"), [("boxes", "png"), ("figure-4a", "svg"), ("figure-2a", "pdf")])
def test_the_same_figure_is_the_same_bytes(name, form, results):
    one, other = (as_bytes(draw(name, results).figure, form) for _ in range(2))
    assert one == other
    assert one.startswith(STARTS[form])


def test_a_drawing_is_three_pictures_and_its_table(results):
    drawing = draw("boxes", results)
    made = files_of(drawing, "boxes")
    assert sorted(made) == ["boxes.csv", "boxes.pdf", "boxes.png", "boxes.svg"]
    assert all(made[f"boxes.{form}"].startswith(start) for form, start in STARTS.items())
    assert made["boxes.csv"].startswith(b"condition,n,excluded,q1,median,q3,")
    assert b"\r" not in made["boxes.csv"]


def test_a_table_comes_back_from_its_csv_bit_for_bit(results):
    drawing = draw("figure-4b", results)
    text = files_of(drawing, "figure-4b", [])["figure-4b.csv"].decode()
    rows = list(csv.DictReader(text.splitlines()))
    assert [float(row["mean"]) for row in rows] == drawing.table["mean"].tolist()
    assert [row["condition"] for row in rows] == drawing.table["condition"].tolist()


def test_letters_of_an_svg_stay_letters_and_no_date_is_in_it(results):
    text = as_bytes(draw("figure-2b", results).figure, "svg").decode()
    assert ">wobble ends</text>" in text
    assert "<dc:date>" not in text


def test_a_cloud_of_dots_is_one_image_in_an_svg(results):
    text = as_bytes(draw("figure-2a", results).figure, "svg").decode()
    assert text.count("<image") >= 2
    assert len(text) < 300_000


def test_a_notebook_shows_a_drawing():
    assert Drawing(new_figure(), pd.DataFrame())._repr_png_().startswith(STARTS["png"])


# --- looks -----------------------------------------------------------------------------------------------------------


def luminance(color):
    """Relative luminance of a colour (WCAG 2)."""
    channels = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in to_rgb(color)]
    return float(np.dot(channels, [0.2126, 0.7152, 0.0722]))


def test_the_baseline_is_black_and_no_two_of_29_conditions_look_alike():
    names = [f"c{n}" for n in range(29)]
    seen = looks(names, "c3")
    assert seen[3] == ("#000000", "-")
    assert len(set(seen)) == 29
    assert "#000000" not in {color for name, (color, _) in zip(names, seen, strict=True) if name != "c3"}


def test_the_colours_are_eight_and_the_first_four_differ_also_in_grey():
    assert len(set(OKABE_ITO)) == 8
    greys = sorted(luminance(color) for color in OKABE_ITO[:4])
    assert min(np.diff(greys)) > 0.05


def test_labels_keep_their_order_and_a_distance_and_move_no_more_than_needed():
    moved = spread([1.0, 1.0, 5.0, 1.1], 0.5)
    assert moved == pytest.approx([1 - 0.5 + 0.1 / 3, 1 + 0.1 / 3, 5.0, 1.5 + 0.1 / 3])


@pytest.mark.parametrize(
    ("numbers", "said"),
    [([1], "1 run"), ([100, 100], "100 runs"), ([97, 100], "97 to 100 runs"), ([0, 1], "0 to 1 run")],
)
def test_numbers_are_said_in_words(numbers, said):
    assert count(numbers, "run") == said


# --- the list --------------------------------------------------------------------------------------------------------


def test_every_figure_has_a_module_with_draw():
    for name, entry in FIGURES.items():
        module = importlib.import_module(f"wobblesim.analysis.figures.{entry.home}")
        assert list(inspect.signature(module.draw).parameters) == ["results", "choice"], name


def test_groups_are_replaced_by_what_they_stand_for_each_once():
    assert expand(["figure-4", "figure-4a", "boxes"]) == ("figure-4a", "figure-4b", "boxes")
    assert expand(["all"]) == tuple(FIGURES)
    assert all(name in FIGURES for group in GROUPS.values() for name in group)


def test_an_unknown_figure_is_refused_with_the_nearest_name(results):
    for ask in (lambda: expand(["figure-3A"]), lambda: draw("figure-3A", results)):
        with pytest.raises(FigureError, match="there is no figure 'figure-3A'; did you mean figure-3"):
            ask()
    with pytest.raises(FigureError, match="there is no figure 'xyz'; there are figure-2a, figure-2b"):
        expand(["xyz"])
    with pytest.raises(FigureError, match="figure-3 stands for several figures: figure-3a, figure-3b, figure-3c"):
        draw("figure-3", results)


def test_what_a_study_lacks_is_said_as_drawing_would_say_it(results):
    for name in ("figure-2a", "figure-3a", "figure-3b", "figure-3c", "figure-4a"):
        reason = lacking(name, results)
        if reason is None:
            assert len(draw(name, results).table)
        else:
            with pytest.raises(FigureError) as raised:
                draw(name, results)
            assert str(raised.value) == reason
    assert lacking("figure-3a", results).startswith("wobble.period does not vary")


def test_a_condition_that_is_not_there_is_refused_with_the_nearest(results):
    with pytest.raises(StoreError, match="has no condition 'masss'; did you mean mass"):
        draw("figure-2b", results, Choice(conditions=("masss",)))
    with pytest.raises(StoreError, match="has no condition 'fixd'; did you mean fixed"):
        draw("boxes", results, Choice(baseline="fixd"))


def test_conditions_are_shown_in_the_order_of_the_study(results):
    assert Choice(conditions=("mass", "fixed")).shown(results) == ["fixed", "mass"]
