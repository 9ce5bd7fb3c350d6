"""One file a condition holds the rows of all its runs, bit for bit, and nothing is lost on the way there."""

import errno
import json
import random
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from faults.disk import Death, Disk, Model, build, die_at, fail_at, without_fsync
from study.toy import TABLES, StopAfter, study, toy

from wobblesim.analysis.statistics import summary
from wobblesim.analysis.tables import load
from wobblesim.commands import main
from wobblesim.study import compact as compact_module
from wobblesim.study import store as store_module
from wobblesim.study.compact import compact
from wobblesim.study.errors import StoreError, WriteError
from wobblesim.study.execute import sweep
from wobblesim.study.files import damage, read_about, read_tables
from wobblesim.study.manifest import read_manifest
from wobblesim.study.store import QUARANTINE, SCRATCH, opened
from wobblesim.study.verify import verify

FIXED = "conditions={fixed: {wobble: null}}"
SMALL = ("learning.epochs=2", "learning.population=4", "learning.parents=2", "log=behaviours")


@pytest.fixture(scope="module")
def origin(tmp_path_factory):
    """The toy study, finished: 8 runs of 4 files each."""
    folder = tmp_path_factory.mktemp("toy")
    sweep(study(), folder, simulate=toy)
    return folder


@pytest.fixture
def done(origin, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(origin, tmp_path / "done"))


def rows_by_run(folder):
    """The rows of each run in each table, numbers by their bits, but for the wall time."""
    found = {}
    for name in TABLES:
        for file in read_manifest(folder).files(name):
            table = read_tables(folder, [file]).to_pandas().drop(columns="seconds", errors="ignore")
            for key, rows in table.groupby(["condition", "seed"], observed=True):
                found[name, *key] = {column: bits(rows[column]) for column in rows}
    return found


def bits(column):
    if column.name == "genotype":
        return np.stack(column).tobytes()
    return column.to_numpy().tobytes() if column.dtype == np.float64 else column.tolist()


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for table in TABLES for path in (folder / table).rglob("*.*"))


# --- the rows ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", TABLES)
def test_the_rows_are_the_same_and_in_the_same_order(done, table):
    before = getattr(load(done), table)()
    compact(done)
    after = getattr(load(done), table)()
    pd.testing.assert_frame_equal(before, after, check_exact=True)
    assert len(read_manifest(done).files(table)) == 2
    order = after[[name for name in ("condition", "seed", "epoch", "slot") if name in after]]
    assert order.apply(tuple, axis=1).is_monotonic_increasing
    for path in (done / table).rglob("*.parquet"):
        seeds = pq.read_table(path, columns=["seed"], partitioning=None)["seed"].to_numpy()
        assert (np.diff(seeds) >= 0).all()


def test_there_is_one_file_for_each_condition_and_table_and_nothing_else_is_left(done):
    merged = compact(done)
    assert [(it.condition, it.runs, it.files) for it in merged.conditions] == [
        ("fixed", 4, (16, 4)),
        ("mass", 4, (16, 4)),
    ]
    assert len(files_in(done)) == 8
    for it in merged.conditions:
        there = [path for table in TABLES for path in (done / table / f"condition={it.condition}").iterdir()]
        assert it.bytes[1] == sum(path.stat().st_size for path in there) < it.bytes[0]
        assert {path.name[:10] for path in there} == {"seeds-0-3-"}
    assert not any((done / SCRATCH).rglob("*.parquet"))
    assert verify(done).findings == ()
    assert verify(done).runs == 8


def test_compacting_twice_changes_nothing(done):
    compact(done)
    before = {path: path.stat().st_ino for path in done.rglob("*.parquet")}
    manifest = (done / "manifest.jsonl").read_bytes()
    assert all(it.files[0] == it.files[1] for it in compact(done).conditions)
    assert {path: path.stat().st_ino for path in done.rglob("*.parquet")} == before
    assert (done / "manifest.jsonl").read_bytes() == manifest


def test_summary_status_and_the_sweep_take_it_as_it_was(done):
    before = summary(load(done))
    status = CliRunner().invoke(main, ["status", str(done)]).output
    compact(done)
    pd.testing.assert_frame_equal(summary(load(done)), before, check_exact=True)
    assert CliRunner().invoke(main, ["status", str(done)]).output == status

    def never(*_, **__):
        raise AssertionError("computed")

    assert sweep(study(), done, simulate=never).present == 8


def test_more_seeds_lie_beside_and_are_merged_by_the_next_call(tmp_path):
    for seeds in ("0,4,9", "2,7,11"):
        sweep(study(seeds=seeds), tmp_path, simulate=toy)
        compact(tmp_path)
    sweep(study(seeds="5,1,20"), tmp_path, simulate=toy)
    order = [0, 1, 2, 4, 5, 7, 9, 11, 20]
    mixed = {name: getattr(load(tmp_path), name)() for name in TABLES}
    for frame in mixed.values():  # five and one lie in files of their own, between seeds of the other
        assert frame["seed"].unique().tolist() == order
    assert load(tmp_path).epochs("best")["best"].equals(mixed["epochs"]["best"])
    assert list(load(tmp_path).epochs("best").columns) == ["best"]
    compact(tmp_path)
    assert len(files_in(tmp_path)) == 8
    for name, frame in mixed.items():
        pd.testing.assert_frame_equal(getattr(load(tmp_path), name)(), frame, check_exact=True)
    whole = tmp_path / "whole"
    sweep(study(seeds=",".join(map(str, order))), whole, simulate=toy)
    assert rows_by_run(tmp_path) == rows_by_run(whole)


def test_robots_of_different_sizes_have_genotypes_of_different_lengths(tmp_path):
    arms = "conditions={three: {robot: {arms: 3}}, five: {robot: {arms: 5}}}"
    sweep(study(arms, *SMALL, seeds="0..1"), tmp_path, simulate=toy)
    before = load(tmp_path).behaviours()
    compact(tmp_path)
    after = load(tmp_path).behaviours()
    lengths = after.groupby("condition", observed=True)["genotype"].agg(lambda column: {len(genes) for genes in column})
    assert lengths.to_dict() == {"three": {12}, "five": {20}}
    assert all(map(np.array_equal, before["genotype"], after["genotype"]))


# --- the file ------------------------------------------------------------------------------------------------------


def test_a_file_says_its_settings_once_and_where_each_run_comes_from(tmp_path, monkeypatch):
    sweep(study(seeds="0..1"), tmp_path, simulate=toy)
    ours = store_module.provenance()
    monkeypatch.setattr(store_module, "provenance", lambda: ours | {"numpy": "9.9", "cpu": "another"})
    sweep(study(seeds="2..3"), tmp_path, simulate=toy)
    compact(tmp_path)
    monkeypatch.setattr(store_module, "provenance", lambda: ours)
    sweep(study(seeds="4"), tmp_path, simulate=toy)
    compact(tmp_path)
    for file in read_manifest(tmp_path).every_file().values():
        about = read_about(tmp_path / file.path)
        assert json.loads(about["config"])["learning"]["epochs"] == 12
        assert json.loads(about["seeds"]) == [0, 1, 2, 3, 4]
        assert about["table"] == file.path.partition("/")[0]
        first, second = json.loads(about["sources"])
        assert first == ours | {"seeds": [0, 1, 4]}
        assert second == ours | {"numpy": "9.9", "cpu": "another", "seeds": [2, 3]}
        # What is the same for all is also said as in the file of one run.
        assert about["kernel"] == ours["kernel"]
        assert "cpu" not in about
        assert "seed" not in about


def test_columns_are_packed_and_checksummed_as_in_the_file_of_a_run(origin, done):
    compact(done)
    for table in TABLES:
        one, many = (pq.ParquetFile(next((folder / table).rglob("*.parquet"))) for folder in (origin, done))
        assert many.schema_arrow.equals(one.schema_arrow)
        for column in range(one.metadata.num_columns):
            before, after = (file.metadata.row_group(0).column(column) for file in (one, many))
            assert after.compression == "ZSTD"
            assert after.encodings == before.encodings, before.path_in_schema
    # A flipped bit in a page is an error to whoever asks for checksums.
    path = next((done / "behaviours").rglob("*.parquet"))
    flip(path, pq.read_metadata(path).row_group(0).column(4).data_page_offset + 400)
    with pytest.raises(OSError, match=r"CRC|checksum"):
        pq.ParquetFile(path, page_checksum_verification=True).read()


@pytest.mark.parametrize(("rows", "expected"), [(500, [480, 480]), (1000, [960]), (100, [240] * 4)])
def test_row_groups_are_whole_runs(done, monkeypatch, rows, expected):
    monkeypatch.setattr(compact_module, "GROUP_ROWS", rows)
    compact(done)
    footer = pq.read_metadata(next((done / "trials").rglob("*.parquet")))
    assert [footer.row_group(group).num_rows for group in range(footer.num_row_groups)] == expected


# --- what is not sound ---------------------------------------------------------------------------------------------


def flip(path, place=-700):
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


def test_a_damaged_file_leaves_its_condition_as_it_was(done):
    flip(done / "trials" / "condition=mass" / "seed-2.parquet")
    before = files_in(done)
    called = CliRunner().invoke(main, ["compact", str(done)])
    assert called.exit_code == 3
    assert "trials/condition=mass/seed-2.parquet: is altered" in called.output
    assert [path for path in files_in(done) if "mass" in path] == [path for path in before if "mass" in path]
    assert sum("fixed" in path for path in files_in(done)) == 4


def test_a_new_file_that_reads_otherwise_than_the_old_ones_is_refused(done, monkeypatch):
    before, manifest = files_in(done), (done / "manifest.jsonl").read_bytes()
    together = compact_module._together

    def one_bit_off(tables):
        made = together(tables)
        if "best" not in made.column_names:
            return made
        best = made["best"].to_numpy().copy()
        best[5:6].view(np.int64)[0] ^= 1
        return made.set_column(made.column_names.index("best"), "best", [best])

    monkeypatch.setattr(compact_module, "_together", one_bit_off)
    found = [finding.what for it in compact(done).conditions for finding in it.findings]
    assert found == ["cannot be merged: the new file of epochs does not read as it was written (seed 0)"] * 2
    assert (files_in(done), (done / "manifest.jsonl").read_bytes()) == (before, manifest)


def test_a_compacted_file_that_is_cut_costs_its_runs_and_they_are_computed_again(done):
    whole = rows_by_run(done)
    compact(done)
    path = next((done / "epochs").rglob("*fixed/*.parquet"))
    path.write_bytes(path.read_bytes()[:-1])
    outcome = sweep(study(), done, simulate=toy)
    assert (outcome.present, outcome.done) == (4, 4)
    assert (done / QUARANTINE / path.relative_to(done)).exists()
    assert rows_by_run(done) == whole
    assert verify(done).findings == ()


def test_a_folder_in_use_and_one_without_results_are_refused(done, tmp_path):
    with opened(done), pytest.raises(StoreError, match="in use by process"):
        compact(done)
    assert CliRunner().invoke(main, ["compact", str(tmp_path / "nothing")]).exit_code == 2


# --- interrupted ---------------------------------------------------------------------------------------------------


def test_it_can_be_stopped_between_two_runs_and_goes_on(done):
    whole = rows_by_run(done)
    before = files_in(done)
    stopped = compact(done, stop=StopAfter(6))
    assert stopped.stopped
    assert (files_in(done), stopped.conditions) == (before, ())
    assert not list((done / SCRATCH).rglob("*.parquet"))
    assert compact(done, stop=StopAfter(6 * 4)).conditions[0].files == (16, 4)
    assert not compact(done).stopped
    assert len(files_in(done)) == 8
    assert rows_by_run(done) == whole


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A condition of three runs with two small tables; two of the runs are in one file already."""
    folder = tmp_path_factory.mktemp("small") / "origin"
    with without_fsync():
        for seeds in ("0,3", "1"):
            sweep(study(*SMALL, "log=epochs", FIXED, seeds=seeds), folder, simulate=toy)
            if seeds == "0,3":
                compact(folder)
    return folder


def check_recovers(folder, wanted):
    """Refuse a folder that lost or doubled a row, or one that the same command does not finish."""
    manifest = read_manifest(folder)
    assert {("runs", *key) for key in manifest.runs} == {key for key in wanted if key[0] == "runs"}
    assert [damage(folder, file) for file in manifest.every_file().values() if damage(folder, file)] == []
    compact(folder)
    assert rows_by_run(folder) == wanted
    assert len(files_in(folder)) == 2
    assert verify(folder).findings == ()


def test_death_at_any_call_loses_nothing_and_doubles_nothing(small, tmp_path):
    wanted, folder = rows_by_run(small), tmp_path / "dying"
    with without_fsync():
        shutil.copytree(small, tmp_path / "whole")
        with Disk(tmp_path / "whole") as whole:
            compact(tmp_path / "whole")
        assert rows_by_run(tmp_path / "whole") == wanted
        points = [number for number, call in enumerate(whole.tried, 1) if call.kind != "read"]
        assert len(points) > 30  # measured 40 to 66: the number of writes goes with the length of the files
        for point in points:
            shutil.copytree(small, folder)
            with Disk(folder, die_at(point)), pytest.raises(Death):
                compact(folder)
            check_recovers(folder, wanted)
            shutil.rmtree(folder)


def test_a_power_cut_at_any_call_loses_nothing(small, tmp_path):
    wanted, folder, rng, seen = rows_by_run(small), tmp_path / "cut", random.Random(5), set()
    with without_fsync():
        shutil.copytree(small, tmp_path / "whole")
        with Disk(tmp_path / "whole") as disk:
            compact(tmp_path / "whole")
        model = Model(small)
        for call in disk.calls:
            model.play(call, tmp_path / "whole")
            for choices in (["none"], ["all", "half", "zeros", "none"]):
                left = model.left(lambda _, choices=choices: rng.choice(choices))
                state = hash(frozenset(item for item in left.items() if f"/{SCRATCH}/" not in item[0]))
                if state not in seen:
                    seen.add(state)
                    build(left, folder)
                    check_recovers(folder, wanted)
                    shutil.rmtree(folder)
    assert len(seen) > 10  # measured 17


def test_a_full_disk_is_told_in_one_sentence_and_harms_nothing(small, tmp_path):
    wanted, folder = rows_by_run(small), tmp_path / "full"
    kinds = frozenset({"open", "write", "mkdir"})
    with without_fsync():
        shutil.copytree(small, tmp_path / "whole")
        with Disk(tmp_path / "whole") as whole:
            compact(tmp_path / "whole")
        points = [number for number, call in enumerate(whole.tried, 1) if call.kind in kinds]
        for point in points:
            shutil.copytree(small, folder)
            refuse = fail_at(point, errno.ENOSPC, kinds, forever=True)
            with Disk(folder, refuse), pytest.raises(StoreError, match="no space left on device") as told:
                compact(folder)
            assert "\n" not in str(told.value)
            check_recovers(folder, wanted)
            shutil.rmtree(folder)
    assert len(points) > 10  # measured 25
    assert issubclass(WriteError, StoreError)


# --- fork ----------------------------------------------------------------------------------------------------------


def test_a_folder_beside_a_compacted_one_takes_over_what_is_unchanged(done, tmp_path):
    whole = rows_by_run(done)
    compact(done)
    computed = []
    changed = study("conditions.mass.wobble.amplitude=0.2")
    outcome = sweep(changed, tmp_path / "beside", simulate=partial(counting, computed), fork_of=done)
    assert (outcome.present, outcome.done) == (4, 4)
    beside = rows_by_run(tmp_path / "beside")
    assert {key: rows for key, rows in beside.items() if key[1] == "fixed"} == {
        key: rows for key, rows in whole.items() if key[1] == "fixed"
    }
    assert verify(tmp_path / "beside").findings == ()
    compact(tmp_path / "beside")
    assert rows_by_run(tmp_path / "beside") == beside
    assert rows_by_run(done) == whole


def counting(computed, body, behaviours, **settings):
    computed.append(len(behaviours))
    return toy(body, behaviours, **settings)


def test_of_a_compacted_file_all_runs_are_taken_over_or_none(done, tmp_path):
    whole = rows_by_run(done)
    compact(done)
    outcome = sweep(study(seeds="0..2"), tmp_path / "fewer", simulate=toy, fork_of=done)
    assert (outcome.present, outcome.done) == (0, 6)
    fewer = rows_by_run(tmp_path / "fewer")
    assert fewer == {key: whole[key] for key in fewer}
    outcome = sweep(study(seeds="0..5"), tmp_path / "more", simulate=toy, fork_of=done)
    assert (outcome.present, outcome.done) == (8, 4)
    more = rows_by_run(tmp_path / "more")
    assert whole == {key: more[key] for key in whole}
    assert verify(tmp_path / "more").findings == ()


# --- the command ---------------------------------------------------------------------------------------------------


def test_the_command_says_files_and_bytes_before_and_after(done):
    size = sum(path.stat().st_size for path in done.rglob("*.parquet"))
    called = CliRunner().invoke(main, ["compact", "--json", str(done)])
    told = json.loads(called.stdout)
    assert (called.exit_code, called.stderr) == (0, "")
    assert (told["files"], told["bytes"][0]) == ([32, 8], size)
    assert told["bytes"][1] == sum(path.stat().st_size for path in done.rglob("*.parquet"))
    assert [it["condition"] for it in told["conditions"]] == ["fixed", "mass"]
    again = CliRunner().invoke(main, ["compact", str(done)])
    assert "8 files, 0.2 MB before; 8 files, 0.2 MB after" in again.stdout
