"""The results folder: what is committed is there, whatever happens to the rest."""

import fcntl
import json
import threading

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from study.toy import TABLES, content, study, toy

from wobblesim.config import parse_config
from wobblesim.study import store as store_module
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.study.files import damage, move_all, read_tables
from wobblesim.study.lock import LOCK
from wobblesim.study.manifest import MANIFEST, read_manifest
from wobblesim.study.schema import schema
from wobblesim.study.store import opened


@pytest.fixture
def done(tmp_path):
    """A finished toy study of 8 runs."""
    sweep(study(), tmp_path, simulate=toy)
    return tmp_path


def test_a_run_is_a_file_in_each_table_and_a_line_of_the_manifest(done):
    manifest = read_manifest(done)
    assert len(manifest.runs) == 8
    for run in manifest.runs.values():
        for file in run.files.values():
            assert pq.read_metadata(done / file.path).num_rows == file.rows
            assert damage(done, file) is None


def test_the_datasets_hold_parquet_files_only(done):
    strangers = [
        path for table in TABLES for path in (done / table).rglob("*") if path.is_file() and path.suffix != ".parquet"
    ]
    assert strangers == []


@pytest.mark.parametrize("table", TABLES)
def test_each_file_has_the_columns_of_its_table(done, table):
    for file in read_manifest(done).files(table):
        assert pq.read_schema(done / file.path).remove_metadata() == schema(table, genes=12)


def test_a_folder_opens_in_pandas_as_it_is(done):
    assert len(pd.read_parquet(done / "epochs")) == 2 * 4 * 12
    runs = pd.read_parquet(done / "runs", filters=[("condition", "==", "mass")])
    assert runs["wobble.amplitude"].tolist() == [0.3] * 4
    assert runs["condition"].unique().tolist() == ["mass"]


def test_floats_are_split_by_bytes_and_pages_carry_a_checksum(done):
    file = pq.ParquetFile(done / read_manifest(done).files("behaviours")[0].path)
    packed = {
        file.metadata.row_group(0).column(i).path_in_schema: file.metadata.row_group(0).column(i) for i in range(5)
    }
    genes = packed["genotype.list.element"]
    assert genes.compression == "ZSTD"
    assert "BYTE_STREAM_SPLIT" in genes.encodings
    file.close()


def test_a_file_says_where_it_comes_from(done):
    metadata = pq.read_metadata(done / read_manifest(done).files("runs")[0].path).metadata
    assert json.loads(metadata[b"wobblesim.config"])["learning"]["epochs"] == 12
    said = {key: metadata[f"wobblesim.{key}".encode()].decode() for key in ("condition", "seed", "numba", "numpy")}
    assert said == {"condition": "fixed", "seed": "0", "numba": said["numba"], "numpy": np.__version__}
    for key in ("schema_version", "version", "llvmlite", "python", "cpu", "kernel", "platform"):
        assert metadata[f"wobblesim.{key}".encode()]


# --- damage --------------------------------------------------------------------------------------------------------


def test_a_flipped_bit_in_a_page_is_never_read_as_a_number(done):
    file = read_manifest(done).files("behaviours")[0]
    place = pq.read_metadata(done / file.path).row_group(0).column(4).data_page_offset
    damaged = bytearray((done / file.path).read_bytes())
    damaged[place + 400] ^= 1
    (done / file.path).write_bytes(damaged)
    with pytest.raises(StoreError, match=r"seed-0.parquet is missing or damaged"):
        read_tables(done, [file])


def test_a_torn_last_line_is_ignored_named_and_its_run_computed_again(done):
    whole = content(done)
    manifest = done / MANIFEST
    manifest.write_bytes(manifest.read_bytes()[:-30])
    assert len(read_manifest(done).runs) == 7
    said = []
    outcome = sweep(study(), done, simulate=toy, progress=said.append)
    assert (outcome.present, outcome.done) == (7, 1)
    notes = [told.message for told in said if told.kind == "note"]
    assert notes[0] == f"{manifest}, line 11: is cut off, and ignored; what it named is computed again"
    assert f"{done / 'runs/condition=mass/seed-3.parquet'} belongs to no run; it is in quarantine now" in notes
    assert len(notes) == 1 + len(TABLES)
    assert content(done) == whole


def test_a_damaged_line_in_the_middle_costs_its_run_only(done):
    lines = (done / MANIFEST).read_bytes().splitlines(keepends=True)
    lines[4] = b"\0" * len(lines[4][:-1]) + b"\n"
    (done / MANIFEST).write_bytes(b"".join(lines))
    manifest = read_manifest(done)
    assert len(manifest.runs) == 7
    assert "line 5: is damaged" in manifest.unreadable[0]


@pytest.mark.parametrize("left", [None, 0, 1, 500, -1])
def test_a_missing_or_cut_file_is_named_and_its_run_computed_again(done, left):
    whole = content(done)
    path = done / read_manifest(done).files("epochs")[3].path
    if left is None:
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:left])
    said = []
    assert sweep(study(), done, simulate=toy, progress=said.append).done == 1
    assert any(str(path) in told.message for told in said if told.kind == "note")
    assert content(done) == whole


def test_new_files_of_a_lost_run_never_stand_under_its_old_line(done, monkeypatch):
    """They are as long as the old ones, for the wall time is a number like any other, and yet not the same."""
    whole = content(done)
    (done / read_manifest(done).files("epochs")[3].path).unlink()

    def dying(moves):
        move_all(moves)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(store_module, "move_all", dying)
        with pytest.raises(KeyboardInterrupt):
            sweep(study(), done, simulate=toy)
    assert len(read_manifest(done).runs) == 7
    assert sweep(study(), done, simulate=toy).done == 1
    assert content(done) == whole


# --- one folder, one process ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("inside", ["file", "file/deeper", "nul\0byte"])
def test_a_folder_that_cannot_be_is_refused_before_anything_is_computed(tmp_path, inside):
    (tmp_path / "file").write_text("in the way")

    def never(*_, **__):
        raise AssertionError("computed")

    with pytest.raises(StoreError, match="cannot write to"):
        sweep(study(), tmp_path / inside, simulate=never)


# --- other settings ------------------------------------------------------------------------------------------------


def test_other_settings_are_refused_with_the_keys_that_differ(done):
    whole = (done / MANIFEST).read_bytes()
    with pytest.raises(StoreError, match=r"\n  learning.rate +0\.1 +0\.2 +in all 2 conditions\n"):
        sweep(study("learning.rate=0.2"), done, simulate=toy)
    assert (done / MANIFEST).read_bytes() == whole


def test_another_simulator_is_refused(done, monkeypatch):
    monkeypatch.setattr(store_module, "kernel_hash", lambda: "another")
    with pytest.raises(StoreError, match="another simulator"):
        sweep(study(), done, simulate=toy)


def test_other_settings_are_welcome_where_nothing_was_computed(tmp_path):
    with opened(tmp_path) as store:
        store.declare({"fixed": {"a": 1}}, (0,), "")
        store.declare({"fixed": {"a": 2}}, (0,), "")
    assert read_manifest(tmp_path).conditions["fixed"]["config"] == {"a": 2}


def test_more_seeds_and_more_conditions_are_added(done):
    before = content(done)
    sweep(study(seeds="2..5"), done, simulate=toy)
    more = study("conditions.size={wobble: {dimension: size, amplitude: 0.1, period: 5, end: 6}}")
    outcome = sweep(more, done, simulate=toy)
    after = content(done)
    assert (outcome.present, outcome.done) == (8, 4)
    assert len(read_manifest(done).runs) == 2 * 6 + 4
    assert before.items() <= after.items()


def test_the_kept_configuration_asks_for_all_seeds_and_gives_the_same_study(done):
    sweep(study(seeds="2..5"), done, simulate=toy)
    kept = parse_config((done / "config.yaml").read_text())
    assert kept.seeds == (0, 1, 2, 3, 4, 5)
    assert sweep(kept, done, simulate=toy).done == 0


@pytest.mark.parametrize("name", ["..", "a/b", "", "17", "a\0b"])
def test_a_condition_cannot_leave_its_folder(tmp_path, name):
    with opened(tmp_path) as store, pytest.raises(StoreError, match="cannot be the id"):
        store.declare({name: {}}, (0,), "")


def test_somebody_who_asks_who_writes_does_not_stop_a_writer(tmp_path):
    with opened(tmp_path):
        pass
    with (tmp_path / LOCK).open("r", encoding="utf-8") as asking:
        fcntl.flock(asking, fcntl.LOCK_SH)
        threading.Timer(0.1, fcntl.flock, (asking.fileno(), fcntl.LOCK_UN)).start()
        with opened(tmp_path) as store:
            assert store.folder == tmp_path
