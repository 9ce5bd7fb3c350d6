"""The datasets open in pandas, DuckDB and Polars as they are, before and after they are compacted."""

import json
import re
import shutil
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.dataset as ds
import pytest
from study.toy import TABLES, study, toy

from wobblesim.analysis.tables import load
from wobblesim.study.compact import compact
from wobblesim.study.execute import sweep
from wobblesim.study.schema import COLUMNS

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "query.md"

SORTED = ("condition", "seed", "epoch", "slot")


@pytest.fixture(scope="module", params=["runs", "compacted", "mixed"])
def folder(request, tmp_path_factory):
    """The toy study, in files of one run, of a condition, or both."""
    folder = tmp_path_factory.mktemp(request.param)
    sweep(study(seeds="0..1" if request.param == "mixed" else None), folder, simulate=toy)
    if request.param != "runs":
        compact(folder)
    sweep(study(), folder, simulate=toy)
    return folder


def by_pandas(folder, table):
    return pd.read_parquet(folder / table)


def by_pyarrow(folder, table):
    return ds.dataset(folder / table).to_table().to_pandas()


def by_duckdb(folder, table, hive="true"):
    files = f"read_parquet('{folder}/{table}/*/*.parquet', hive_partitioning = {hive})"
    return duckdb.connect().execute(f"SELECT * FROM {files}").df()


def by_duckdb_without_hive(folder, table):
    return by_duckdb(folder, table, hive="false")


def by_polars(folder, table, *, hive=True):
    return pl.scan_parquet(folder / table, hive_partitioning=hive).collect().to_pandas()


def by_polars_without_hive(folder, table):
    return by_polars(folder, table, hive=False)


READERS = [by_pandas, by_pyarrow, by_duckdb, by_duckdb_without_hive, by_polars, by_polars_without_hive]


def plain(frame):
    """A frame as all readers give it: sorted, words and missing values as Python has them, numbers as doubles."""
    frame = frame.sort_values([name for name in SORTED if name in frame], ignore_index=True)
    columns = {}
    for name, column in frame.items():
        if name == "genotype":
            columns[name] = [tuple(np.asarray(genes, dtype=np.float64)) for genes in column]
        elif name in WORDS:
            columns[name] = [None if pd.isna(word) else str(word) for word in column]
        else:
            columns[name] = column.astype("float64")
    return pd.DataFrame(columns)


WORDS = {name for table in COLUMNS.values() for name, kind in table.items() if "string" in str(kind)}


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("read", READERS)
def test_a_reader_finds_the_rows_that_load_finds(folder, table, read):
    frame = getattr(load(folder), table)()
    assert len(frame) == {"runs": 8, "epochs": 96}.get(table, 1920)
    frame["condition"] = frame["condition"].astype(str)
    # Bit for bit: these are numbers read from the same bytes.
    pd.testing.assert_frame_equal(plain(read(folder, table)), plain(frame), check_exact=True)


@pytest.mark.parametrize("read", READERS)
def test_there_is_one_column_of_conditions_and_it_agrees_with_the_folders(folder, read):
    frame = read(folder, "runs")
    assert list(frame.columns).count("condition") == 1
    assert frame["condition"].astype(str).value_counts().to_dict() == {"fixed": 4, "mass": 4}
    moving = frame["condition"].astype(str) == "mass"
    assert (frame["wobble.amplitude"].fillna(0.0) == np.where(moving, 0.3, 0.0)).all()


def test_a_filter_on_the_condition_leaves_the_files_of_others_alone(folder, tmp_path):
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    for path in (copy / "epochs" / "condition=mass").iterdir():  # the columns are read off the first file of all
        path.write_bytes(b"not Parquet")
    files = f"read_parquet('{copy}/epochs/*/*.parquet', hive_partitioning = true)"
    duck = duckdb.connect().execute(f"SELECT * FROM {files} WHERE condition = 'fixed'").df()
    some = pd.read_parquet(copy / "epochs", filters=[("condition", "==", "fixed")])
    assert len(duck) == len(some) == 48


def test_genotypes_are_arrays(folder):
    frame = load(folder).behaviours()
    ours = np.stack(frame["genotype"])
    order = "ORDER BY condition, seed, epoch, slot"
    files = f"read_parquet('{folder}/behaviours/*/*.parquet')"
    duck = duckdb.connect().execute(f"SELECT genotype::DOUBLE[12] AS genotype FROM {files} {order}").df()
    polars = pl.scan_parquet(folder / "behaviours").sort(SORTED).collect()
    assert polars.schema["genotype"] == pl.Array(pl.Float64, 12)
    pandas = pd.read_parquet(folder / "behaviours").sort_values(list(SORTED))
    for theirs in (np.stack(duck["genotype"]), polars["genotype"].to_numpy(), np.stack(pandas["genotype"])):
        assert theirs.tobytes() == ours.tobytes()


def test_what_a_file_says_of_itself_is_read_by_duckdb_and_polars(folder):
    for path in folder.rglob("*.parquet"):
        said = (
            duckdb.connect().execute(f"SELECT decode(key), decode(value) FROM parquet_kv_metadata('{path}')").fetchall()
        )
        about = {key: value for key, value in said if key.startswith("wobblesim.")}
        polars = pl.read_parquet_metadata(path)
        assert about == {key: value for key, value in polars.items() if key.startswith("wobblesim.")}
        assert json.loads(about["wobblesim.config"])["learning"]["epochs"] == 12
        assert (about["wobblesim.table"], about["wobblesim.condition"]) == (
            path.relative_to(folder).parts[0],
            path.parent.name.removeprefix("condition="),
        )
        assert ("wobblesim.sources" in about) == path.name.startswith("seeds-")


def test_robots_of_different_sizes_open_condition_by_condition(tmp_path):
    arms = "conditions={three: {robot: {arms: 3}}, five: {robot: {arms: 5}}}"
    sweep(study(arms, "learning.epochs=2", seeds="0..1"), tmp_path, simulate=toy)
    files = f"read_parquet('{tmp_path}/behaviours/*/*.parquet')"
    query = f"SELECT DISTINCT condition, len(genotype) FROM {files} ORDER BY condition"
    assert duckdb.connect().execute(query).fetchall() == [("five", 20), ("three", 12)]
    assert np.stack(pd.read_parquet(tmp_path / "behaviours" / "condition=five")["genotype"]).shape == (80, 20)
    five = pl.scan_parquet(tmp_path / "behaviours" / "condition=five").collect()
    assert five["genotype"].to_numpy().shape == (80, 20)


# --- the page ------------------------------------------------------------------------------------------------------


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


@pytest.fixture
def here(folder, tmp_path, monkeypatch):
    """A working folder in which the page's paths lead to results."""
    shutil.copytree(folder, tmp_path / "results" / "study")
    monkeypatch.chdir(tmp_path)
    return load(folder)


def test_the_python_of_the_page_runs_and_finds_what_load_finds(here, capsys):
    names = {}
    blocks_of_page = blocks("python")
    assert len(blocks_of_page) == 6
    for block in blocks_of_page:
        exec(compile(block, str(PAGE), "exec"), names)
    epochs, behaviours = here.epochs(), here.behaviours()
    mean = epochs[epochs["condition"] == "mass"].groupby("epoch")["best"].mean()
    assert names["curve"].to_numpy() == pytest.approx(
        mean.to_numpy(), rel=1e-14
    )  # measured 2.2e-16: another order of adding
    assert names["curves"]["mean"].to_numpy() == pytest.approx(mean.to_numpy(), rel=1e-14)
    last = behaviours[behaviours["epoch"] == 11]
    assert names["genotypes"].tobytes() == np.stack(last["genotype"]).tobytes()
    assert "mass" in capsys.readouterr().out


def test_the_sql_of_the_page_runs_and_finds_what_load_finds(here):
    means, joined, genotypes, about = (duckdb.connect().execute(block).df() for block in blocks("sql"))
    epochs = here.epochs()
    mean = epochs.groupby(["condition", "epoch"], observed=True)["best"].mean()
    assert means["mean"].to_numpy() == pytest.approx(mean.to_numpy(), rel=1e-14)  # measured 2.2e-16
    assert (means["runs"] == 4).all()
    runs = here.runs().sort_values("performance", ascending=False)
    assert joined["performance"].tolist() == runs["performance"].tolist()
    assert joined["best_of_epoch_5"].notna().all()
    assert len(genotypes) == 960
    assert set(about["key"]) == {"wobblesim.version", "wobblesim.cpu", "wobblesim.config"}
