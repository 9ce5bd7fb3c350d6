"""Figure 4 A: principal components of a known plane, and a map whose marks and distances are those of the run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from study.toy import outcome, study, toy

from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.exploration import principal_components, search_distances
from wobblesim.analysis.figures.registry import Choice, draw
from wobblesim.analysis.figures.search_map import MARKS, map_of
from wobblesim.analysis.statistics import mean_of
from wobblesim.analysis.tables import load
from wobblesim.study.execute import sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    sweep(study("learning.epochs=30", "conditions.mass.wobble.end=20"), folder, simulate=toy)
    return load(folder)


@pytest.fixture(scope="module")
def drawing(results):
    return draw("figure-4a", results, Choice(seed=1))


def distances_between(points):
    return np.linalg.norm(points[:, None] - points[None], axis=-1)


def descendants(results, condition, seed):
    """The lineage of the behaviour in epoch 0 that the final best comes from, found one by one."""
    rows = results.lineage(condition=condition, seed=seed)
    start = results.ancestors(condition, seed)["slot"].iloc[0]
    mine = {(0, start)}
    for epoch, slot, parent in rows[["epoch", "slot", "parent"]].itertuples(index=False):
        if (epoch - 1, parent) in mine:
            mine.add((epoch, slot))
    return rows[[key in mine for key in zip(rows["epoch"], rows["slot"], strict=True)]]


# --- principal components --------------------------------------------------------------------------------------------


def test_points_on_a_plane_in_24_dimensions_keep_their_distances():
    rng = np.random.default_rng(0)
    plane = np.linalg.qr(rng.normal(size=(24, 2)))[0]
    points = rng.normal(size=(50, 2)) * [3.0, 1.0] @ plane.T + rng.normal(size=24)
    scores, axes, explained = principal_components(points)
    assert explained.sum() == pytest.approx(1.0, abs=1e-14)  # measured 0
    assert explained[0] > explained[1] > 0
    assert distances_between(scores) == pytest.approx(distances_between(points), abs=1e-13)  # measured 5e-15
    assert axes @ axes.T == pytest.approx(np.eye(2), abs=1e-14)  # measured 4e-16
    assert axes @ plane @ plane.T == pytest.approx(axes, abs=1e-14)  # measured 3e-16: they lie in the plane


def test_components_are_the_axes_of_a_cloud_along_coordinates():
    # Variances 9 and 4 along the coordinates 3 and 1: the shares are 9/13 and 4/13.
    points = np.zeros((4, 5))
    points[0, 3], points[1, 3], points[2, 1], points[3, 1] = 3.0, -3.0, 2.0, -2.0
    scores, axes, explained = principal_components(points + 7.0)
    assert explained == pytest.approx([9 / 13, 4 / 13], rel=1e-14)  # measured 2e-16
    assert axes == pytest.approx(np.eye(5)[[3, 1]], abs=1e-14)  # measured 0
    assert scores == pytest.approx(np.array([[3, 0], [-3, 0], [0, 2], [0, -2]]), abs=1e-14)  # measured 0


def test_explained_shares_are_eigenvalues_of_the_covariance():
    points = np.random.default_rng(2).normal(size=(200, 24)) * np.linspace(1, 3, 24)
    eigenvalues = np.linalg.eigvalsh(np.cov(points.T))[::-1]
    expected = eigenvalues[:2] / eigenvalues.sum()
    assert principal_components(points).explained == pytest.approx(expected, rel=1e-12)  # measured 1e-15


@given(st.integers(0, 1000))
def test_the_sign_does_not_depend_on_the_order_of_the_points(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 6)) * np.arange(1, 7)
    shuffled = rng.permutation(12)
    scores, axes, _ = principal_components(points)
    again = principal_components(points[shuffled])
    assert again.axes == pytest.approx(axes, abs=1e-11)  # measured 2e-14, over all seeds
    assert again.scores == pytest.approx(scores[shuffled], abs=1e-10)  # measured 2e-13
    assert (axes.max(axis=1) == np.abs(axes).max(axis=1)).all()  # the largest loading is positive


def test_few_points_have_two_axes_all_the_same():
    one = principal_components(np.ones((1, 24)))
    assert one.scores.tolist() == [[0.0, 0.0]]
    assert np.isnan(one.explained).all()
    two = principal_components(np.array([np.zeros(24), np.ones(24)]))
    assert two.explained == pytest.approx([1.0, 0.0], abs=1e-15)
    assert distances_between(two.scores)[0, 1] == pytest.approx(np.sqrt(24.0), rel=1e-14)  # measured 4e-16
    assert two.axes @ two.axes.T == pytest.approx(np.eye(2), abs=1e-14)


# --- the map ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("condition", "split"), [("fixed", 15), ("mass", 20)])
def test_marks_are_on_the_ancestry_of_the_final_best(results, condition, split):
    rows = map_of(results, condition, 1).rows
    ancestors = results.ancestors(condition, 1).set_index("epoch")["slot"]
    marked = rows[rows["mark"] != ""].set_index("mark")
    assert marked.index.tolist() == ["start", "half-way", "end"]
    assert marked["epoch"].tolist() == [0, split, 29]
    assert marked["slot"].tolist() == [ancestors[0], ancestors[split], ancestors[29]]


def test_distances_between_the_marks_are_those_of_the_run(results):
    runs = results.runs("condition", "seed", "path_before", "path_after").set_index(["condition", "seed"])
    for condition in ("fixed", "mass"):
        found = map_of(results, condition, 1)
        assert (found.before, found.after) == tuple(runs.loc[(condition, 1)])
        path = results.ancestors(condition, 1)
        on_the_way = path.loc[path["epoch"] <= found.split, "modification"].sum()
        assert on_the_way == pytest.approx(found.before, rel=1e-12)  # measured 0
        assert path["modification"].sum() - on_the_way == pytest.approx(found.after, rel=1e-12)  # measured 9e-16


def test_components_are_those_of_the_distinct_behaviours_that_are_shown(results):
    rows = descendants(results, "mass", 1)
    genotypes = np.stack(rows["genotype"])
    found = map_of(results, "mass", 1)
    distinct = np.unique(genotypes, axis=0)
    _, axes, explained = principal_components(distinct)
    assert found.explained == pytest.approx(explained, rel=1e-12)  # measured 6e-16
    expected = (genotypes - distinct.mean(axis=0)) @ axes.T
    assert found.rows[["component_1", "component_2"]].to_numpy() == pytest.approx(expected, abs=1e-12)  # measured 2e-16


def test_each_edge_goes_from_a_parent_to_a_child_that_differs(results):
    found = map_of(results, "mass", 1)
    places = found.rows.set_index(["epoch", "slot"])[["component_1", "component_2"]]
    children = found.rows[(found.rows["modification"] > 0)]
    assert len(found.edges) == len(children) == len(found.born)
    for edge, (_, child) in zip(found.edges, children.iterrows(), strict=True):
        assert edge[0].tolist() == places.loc[(child["epoch"] - 1, child["parent"])].tolist()
        assert edge[1].tolist() == places.loc[(child["epoch"], child["slot"])].tolist()


def test_the_picture_has_the_edges_by_epoch_and_the_marks_of_the_table(results, drawing):
    for axes, condition in zip(drawing.figure.axes, ("fixed", "mass"), strict=False):
        found = map_of(results, condition, 1)
        (edges,) = (artist for artist in axes.collections if isinstance(artist, LineCollection))
        assert np.array_equal(np.array(edges.get_segments()), found.edges)
        assert edges.get_array().tolist() == found.born.tolist()
        assert edges.get_clim() == (0, 29)
        marked = drawing.table[(drawing.table["condition"] == condition) & (drawing.table["mark"] != "")]
        drawn = {line.get_label(): (*line.get_xdata(), *line.get_ydata(), line.get_marker()) for line in axes.lines}
        assert drawn == {
            row["mark"]: (row["component_1"], row["component_2"], MARKS[row["mark"]])
            for row in marked.to_dict("records")
        }


def test_titles_say_the_distances_of_the_run_and_their_means(results, drawing):
    runs = results.runs("condition", "path_before", "path_after")
    mine = runs[runs["condition"] == "mass"]
    before, after = mean_of(mine["path_before"]), mean_of(mine["path_after"])
    found = map_of(results, "mass", 1)
    assert drawing.figure.axes[1].get_title(loc="left").splitlines() == [
        f"mass: {found.before:.2f} to epoch 20, then {found.after:.2f}",
        f"4 runs: {before.mean:.2f} ± {before.half_width:.2f}, then {after.mean:.2f} ± {after.half_width:.2f}",
    ]
    assert drawing.figure.axes[0].get_title(loc="left").startswith("fixed: ")
    assert f"{100 * found.explained[0]:.0f} % of the variance" in drawing.figure.axes[1].get_xlabel()
    assert "seed 1" in drawing.figure.get_suptitle()


def test_the_table_has_a_row_for_each_behaviour_shown_in_each_of_its_epochs(results, drawing):
    for condition, mine in drawing.table.groupby("condition", sort=False):
        lineage = descendants(results, condition, 1)
        names = ["epoch", "slot", "parent", "best", "final"]
        assert mine[names].to_numpy().tolist() == lineage[names].to_numpy().tolist()
        assert mine["best"].sum() + map_of(results, condition, 1).left_out == 30


def test_what_descends_from_another_behaviour_is_left_out_and_counted(tmp_path):
    def heavy_goes_back(body, behaviours, *, morphology, **settings):
        """What is best in epoch 0 is worst in the next ones."""
        trials = toy(body, behaviours, morphology=morphology, **settings)
        return trials if morphology.mass <= 1.0 else outcome(-trials.displacement, trials.status == "diverged")

    sweep(study(seeds="0"), tmp_path, simulate=heavy_goes_back)
    results = load(tmp_path)
    whole, tree = results.lineage(condition="mass", seed=0), descendants(results, "mass", 0)
    found = map_of(results, "mass", 0)
    assert found.left_out == whole["best"].sum() - tree["best"].sum() > 0
    assert len(found.rows) == len(tree) < len(whole)
    assert (found.rows["epoch"] == 0).sum() == 1
    title = draw("figure-4a", results, Choice(conditions=("mass",))).figure.get_suptitle()
    assert f"but for {found.left_out} epoch" in title


def test_the_numbers_of_the_text_are_means_over_the_runs(results):
    found = search_distances(results).set_index("condition")
    runs = results.runs("condition", "path_before", "path_after")
    for condition, mine in runs.groupby("condition", observed=True):
        before = mean_of(mine["path_before"])
        row = found.loc[condition]
        assert (row["before"], row["before_half_width"], row["n"]) == (before.mean, before.half_width, 4)
        assert row["after"] == mean_of(mine["path_after"]).mean
    assert found["split"].to_dict() == {"fixed": 15, "mass": 20}


# --- extremes --------------------------------------------------------------------------------------------------------


def test_one_run_has_no_mean_and_a_wobble_to_the_last_epoch_ends_half_way_there(tmp_path):
    sweep(study("conditions.mass.wobble.end=40", seeds="2"), tmp_path, simulate=toy)
    drawing = draw("figure-4a", load(tmp_path))
    assert "the only run" in drawing.figure.axes[1].get_title(loc="left")
    marked = drawing.table[drawing.table["condition"] == "mass"].query("mark != ''")
    assert marked["mark"].tolist() == ["start", "end"]


def test_a_run_of_one_epoch_is_a_point(tmp_path):
    sweep(study("learning.epochs=1", "conditions.mass.wobble.end=1", seeds="0"), tmp_path, simulate=toy)
    drawing = draw("figure-4a", load(tmp_path))
    assert drawing.table["mark"].tolist() == ["end", "end"]
    assert drawing.figure.axes[0].get_xlabel() == "component 1"


def test_a_study_that_kept_no_behaviours_is_refused(tmp_path):
    sweep(study("log=trials", seeds="0"), tmp_path, simulate=toy)
    with pytest.raises(
        FigureError, match="behaviours are shown as points, and fixed and mass kept none; set `log: beh"
    ):
        draw("figure-4a", load(tmp_path))
