"""`wobblesim stats`: two tables to read, the same numbers for other programs, and one sentence for a mistake."""

import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from rich.console import Console
from study.toy import STUDY, outcome, toy

from wobblesim.analysis.comparison import compare
from wobblesim.analysis.export import COLUMNS, flat
from wobblesim.analysis.tables import load
from wobblesim.commands import main
from wobblesim.commands.stats import _fitting
from wobblesim.config import parse_config
from wobblesim.study.compact import compact
from wobblesim.study.execute import sweep

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "statistics.md"
CONDITIONS = {
    "fixed": "{wobble: null}",
    "mass": "{wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 6}}",
    "size_3": "{wobble: {dimension: size, amplitude: 0.3, period: 5, end: 6}}",
}


def of(*conditions, seeds):
    """The toy study of some conditions."""
    listed = "".join(f"  {name}: {CONDITIONS[name]}\n" for name in conditions)
    return parse_config(f"{STUDY.partition('conditions:')[0]}conditions:\n{listed}", ("log=epochs",), seeds)


def uneven(body, behaviours, *, morphology, **_):
    """A task that is another one for each mass and size, so that conditions end with different scores."""
    place = np.sin(40 * behaviours[:, 1] * morphology.mass) + behaviours[:, 2] * morphology.size
    return outcome(place, diverged=behaviours[:, 0] > 0.92)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three conditions; a second command has added two seeds to two of them."""
    folder = tmp_path_factory.mktemp("stats")
    sweep(of(*CONDITIONS, seeds="0..7"), folder, simulate=uneven)
    sweep(of("fixed", "size_3", seeds="0..9"), folder, simulate=uneven)
    return folder


def call(*arguments):
    return CliRunner().invoke(main, ["stats", *map(str, arguments)])


def test_two_tables_and_what_their_columns_are(folder):
    found = call(folder)
    assert (found.exit_code, found.stderr) == (0, "")
    pairs = compare(load(folder)).pairs.set_index("condition")
    lines = {line.split()[0]: line.split() for line in found.stdout.splitlines() if line.startswith((" mass", " size"))}
    row = pairs.loc["mass"]
    assert lines["mass"][1:5] == ["8", f"{row['difference']:+.3f}", "±", f"{row['difference_half_width']:.3f}"]
    assert lines["mass"][-4:-1] == [f"{row[name]:#.3g}" for name in ("shapiro_p", "p", "p_holm")]
    for what in ("excluded:", "pairs:", "effect:", "corrected for 2 tests; * below 0.01"):
        assert what in found.stdout
    assert "mass: 2 of 10 seeds make no pair: 8, 9 (no run of mass)\n" in found.stdout


def test_all_of_it_is_there_as_json(folder):
    told = json.loads(call(folder, "--json", "--baseline", "size_3", "--alpha", 0.05).stdout)
    found = compare(load(folder), "size_3", 0.05)
    assert (told["baseline"], told["alpha"], told["confidence"]) == ("size_3", 0.05, 0.99)
    assert [row["mean"] for row in told["conditions"]] == found.conditions["mean"].tolist()
    assert [row["p_holm"] for row in told["pairs"]] == found.pairs["p_holm"].tolist()
    assert told["pairs"][1]["missing_seeds"] == [{"seed": seed, "why": "no run of mass"} for seed in (8, 9)]
    assert told["notes"] == list(found.notes)


def test_only_some_conditions_are_a_family_of_their_own(folder):
    told = json.loads(call(folder, "--json", "--condition", "size_3").stdout)
    assert [row["condition"] for row in told["conditions"]] == ["fixed", "size_3"]
    assert told["pairs"][0]["p_holm"] == told["pairs"][0]["p"]


def test_csv_and_parquet_hold_every_number_bit_for_bit(folder, tmp_path):
    csv, parquet = tmp_path / "numbers.csv", tmp_path / "numbers.parquet"
    found = call(folder, "--csv", csv, "--parquet", parquet)
    assert found.stderr == f"written: {csv}\nwritten: {parquet}\n"
    expected = flat(compare(load(folder)))
    types = {name: expected[name].dtype for name in ("n_pairs", "missing", "normal", "significant")}
    read = pd.read_csv(csv, dtype=types, keep_default_na=False, na_values={name: [""] for name in numbers(expected)})
    pd.testing.assert_frame_equal(read, expected, check_exact=True, check_dtype=False)
    pd.testing.assert_frame_equal(pd.read_parquet(parquet), expected, check_exact=True)


def numbers(frame):
    return [name for name in frame if name not in ("condition", "missing_seeds", "baseline")]


def test_the_parquet_file_says_what_its_columns_are_and_what_made_it(folder, tmp_path):
    call(folder, "--parquet", tmp_path / "numbers.parquet")
    schema = pq.read_schema(tmp_path / "numbers.parquet")
    assert schema.field("mean").metadata[b"unit"] == b"body lengths"
    assert {name: COLUMNS[name].meaning for name in schema.names} == {
        field.name: field.metadata[b"meaning"].decode() for field in schema
    }
    told = {name.decode(): value.decode() for name, value in schema.metadata.items() if name.startswith(b"wobblesim.")}
    assert (told["wobblesim.table"], told["wobblesim.baseline"], told["wobblesim.alpha"]) == (
        "statistics",
        "fixed",
        "0.01",
    )
    assert told["wobblesim.kernel"] == load(folder).manifest.conditions["fixed"]["kernel"]
    assert not [value for value in told.values() if str(folder) in value]


def test_the_latex_table_is_written(folder, tmp_path):
    assert call(folder, "--latex", tmp_path / "table.tex").exit_code == 0
    text = (tmp_path / "table.tex").read_text(encoding="utf-8")
    assert r"size\_3 & $10$" in text
    assert text.splitlines()[0].startswith("% ")
    assert text.endswith("\\end{tabular}\n")


def test_after_compacting_the_numbers_are_the_same(tmp_path):
    sweep(of(*CONDITIONS, seeds="0..3"), tmp_path, simulate=uneven)
    before = call(tmp_path, "--json").stdout
    compact(tmp_path)
    assert call(tmp_path, "--json").stdout == before


def test_one_condition_has_a_table_and_a_sentence(tmp_path):
    sweep(of("mass", seeds="0"), tmp_path, simulate=toy)
    found = call(tmp_path)
    assert found.exit_code == 0
    assert "one condition: there is nothing to compare" in found.stdout
    assert "Wilcoxon" not in found.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["--baseline", "size_4"], 2, "has no condition 'size_4'; did you mean size_3?"),
        (["--csv", "nowhere/numbers.csv"], 1, "cannot write nowhere/numbers.csv: no such file or directory"),
        (["--alpha", "0"], 2, "0.0 is not in the range 0.0<x<1.0"),
        (["--latex", "."], 2, "is a directory"),
    ],
)
def test_a_mistake_is_one_sentence_and_prints_no_table(folder, arguments, code, told):
    found = call(folder, *arguments)
    assert (found.exit_code, found.stdout) == (code, "")
    assert told in found.stderr
    assert "Traceback" not in found.stderr


def test_a_folder_without_results_is_refused(tmp_path):
    found = call(tmp_path / "nothing")
    assert (found.exit_code, found.stdout) == (2, "")
    assert "holds no results" in found.stderr


def test_a_table_wider_than_the_terminal_is_printed_in_parts_each_with_the_conditions(folder, monkeypatch):
    assert _fitting([9, 6, 10, 15, 15], 40) == [[0, 1, 2, 3], [0, 4]]
    assert _fitting([9, 50, 50], 40) == [[0, 1], [0, 2]]
    monkeypatch.setattr("rich.console.Console", narrow_terminal)
    text = call(folder).stdout
    tables = [line for line in text.splitlines() if line.startswith((" condition", " against fixed"))]
    assert len(tables) == 4
    assert "…" not in text
    whole = " ".join(tables).split()
    assert all(name in whole for name in ("excluded", "limited", "Wilcoxon", "t"))


def narrow_terminal(**settings):
    return Console(**settings | {"file": io.StringIO(), "force_terminal": True, "width": 80, "color_system": None})


def test_the_page_says_what_every_column_is():
    page = PAGE.read_text(encoding="utf-8")
    assert not [name for name in COLUMNS if f"`{name}`" not in page]
