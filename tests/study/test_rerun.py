"""A stored run, repeated from its file alone: the same bits, or what differs, to the row and the last digit."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from study.toy import TABLES, study, toy

from wobblesim.study import rerun as module
from wobblesim.study.compact import compact
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import MANIFEST
from wobblesim.study.provenance import provenance
from wobblesim.study.rerun import Difference, read_run, rerun

ROOT = Path(__file__).parents[2]
ROBOT = ("learning.epochs=5", "trial.duration=1.5", "conditions.mass.wobble.end=3")


@pytest.fixture(scope="module")
def toys(tmp_path_factory):
    """The toy study, finished."""
    folder = tmp_path_factory.mktemp("toys")
    sweep(study(), folder, simulate=toy)
    return folder


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    """A small robot of the real simulator: two conditions, three seeds in lockstep."""
    folder = tmp_path_factory.mktemp("robots")
    sweep(study(*ROBOT, seeds="0..2"), folder)
    return folder


def file_of(folder, table, condition="mass", seed=2):
    return folder / table / f"condition={condition}" / f"seed-{seed}.parquet"


def rewritten(source: Path, target: Path, about=None, **columns) -> Path:
    """A copy of a file with other metadata (None: none) and columns."""
    table = pq.ParquetFile(source).read()
    kept = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    changed = kept | {f"wobblesim.{name}": value for name, value in (about or {}).items()}
    for name, column in columns.items():
        place = table.column_names.index(name)
        table = table.set_column(place, table.schema.field(name), pa.array(column, table.schema.field(name).type))
    told = {name: value for name, value in changed.items() if value is not None}
    pq.write_table(table.replace_schema_metadata(told), target)
    return target


def with_settings(source: Path, target: Path, **changes) -> Path:
    """A copy of a file whose metadata tell of other settings."""
    config = json.loads(module.read_about(source)["config"])
    for key, value in changes.items():
        section, _, name = key.partition("__")
        config[section][name] = value
    return rewritten(source, target, {"config": json.dumps(config)})


# --- the same ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("condition", ["fixed", "mass"])
def test_a_run_of_the_robot_comes_out_the_same_to_the_last_bit(robots, table, condition):
    for threads in (1, 2):
        found = rerun(read_run(file_of(robots, table, condition)), threads=threads)
        assert found.differences == ()
        assert (found.agree, found.epochs, found.changed) == (True, 5, {})
        assert found.rows == {"runs": 1, "epochs": 5}.get(table, 100)


@pytest.mark.parametrize("table", TABLES)
def test_a_file_needs_neither_its_folder_nor_its_name(toys, tmp_path, table):
    copy = shutil.copy(file_of(toys, table), tmp_path / "some file")
    run = read_run(copy)
    assert (run.table, run.condition, run.seed) == (table, "mass", 2)
    assert rerun(run, simulate=toy).agree


def test_every_column_but_the_wall_time_is_compared(toys):
    for table in TABLES:
        run = read_run(file_of(toys, table))
        assert rerun(run, simulate=toy).columns == len(run.rows.column_names) - (table == "runs")


def test_another_seed_or_another_task_does_not_agree(toys, tmp_path):
    wrong = rewritten(file_of(toys, "epochs"), tmp_path / "x", {"seed": "1"}, seed=[1] * 12)
    assert not rerun(read_run(wrong), simulate=toy).agree
    assert not rerun(read_run(file_of(toys, "epochs"))).agree


def test_progress_goes_from_nothing_to_all(toys):
    said = []
    rerun(read_run(file_of(toys, "epochs")), 7, simulate=toy, progress=said.append)
    assert [told.kind for told in said] == ["begin", *["epoch"] * 7, "end"]
    assert [told.epoch for told in said[1:-1]] == list(range(1, 8))
    assert (said[0].fraction, said[-1].fraction, said[-1].done) == (0.0, pytest.approx(1.0), 1)


# --- told exactly --------------------------------------------------------------------------------------------------


def values(path, column):
    return pq.ParquetFile(path).read()[column].to_pylist()


def test_a_last_bit_that_is_flipped_is_told_with_its_row(toys, tmp_path):
    source = file_of(toys, "trials")
    performance = np.array(values(source, "performance"))
    row = 137
    assert np.isfinite(performance[row])
    was, performance[row] = performance[row], np.nextafter(performance[row], np.inf)
    found = rerun(read_run(rewritten(source, tmp_path / "x", performance=performance)), simulate=toy)
    gap = performance[row] - was
    assert found.differences == (Difference("performance", 1, row, performance[row], was, gap),)
    assert found.place(row) == {"epoch": 6, "slot": 17}


@pytest.mark.parametrize(
    ("column", "row", "value"),
    [
        ("performance", 3, None),
        ("performance", 3, float("nan")),
        ("status", 50, "limited"),
        ("slot", 0, 1),
        ("reused", 239, None),
        ("condition", 100, "fixed"),
    ],
)
def test_a_changed_value_of_any_kind_is_the_only_one_told(toys, tmp_path, column, row, value):
    source = file_of(toys, "trials")
    column_values = values(source, column)
    changed = [*column_values[:row], value, *column_values[row + 1 :]]
    found = rerun(read_run(rewritten(source, tmp_path / "x", **{column: changed})), simulate=toy)
    assert value != column_values[row]
    (told,) = found.differences
    assert (told.column, told.rows, told.first, told.here) == (column, 1, row, column_values[row])
    assert told.stored == value or np.isnan(told.stored)


def test_the_sign_of_zero_and_the_bits_of_nan_are_bits_too(toys, tmp_path):
    source = file_of(toys, "trials")
    times = np.array(values(source, "diverged_at"))
    row = int(np.flatnonzero(np.isnan(times))[0])
    times[row] = np.array([0x7FF8000000000001], np.uint64).view(float)[0]
    (told,) = rerun(read_run(rewritten(source, tmp_path / "x", diverged_at=times)), simulate=toy).differences
    assert (told.column, told.rows, told.first, told.largest) == ("diverged_at", 1, row, None)
    source = file_of(toys, "epochs")
    path = np.array(values(source, "path"))
    assert path[0].tobytes() == bytes(8)
    path[0] = -0.0
    (told,) = rerun(read_run(rewritten(source, tmp_path / "x", path=path)), simulate=toy).differences
    assert (told.column, told.rows, told.first, told.largest) == ("path", 1, 0, 0.0)


def test_a_changed_gene_is_told_as_one_row_of_behaviours(toys, tmp_path):
    source = file_of(toys, "behaviours")
    genes = np.array(values(source, "genotype"))
    was, genes[77, 5] = genes[77, 5], genes[77, 5] + 0.25
    found = rerun(read_run(rewritten(source, tmp_path / "x", genotype=genes.tolist())), simulate=toy)
    gap = genes[77, 5] - was  # 0.25 to rounding
    assert found.differences == (Difference("genotype", 1, 77, genes[77, 5], was, gap),)


def test_columns_that_are_missing_new_or_of_another_type_are_told(toys, tmp_path):
    table = pq.ParquetFile(file_of(toys, "epochs")).read()
    changed = table.drop_columns(["path"]).append_column("extra", pa.array(range(12)))
    place = changed.column_names.index("ok")
    changed = changed.set_column(place, "ok", changed["ok"].cast(pa.int64()))
    pq.write_table(changed, tmp_path / "x")
    found = rerun(read_run(tmp_path / "x"), simulate=toy)
    told = {it.column: (it.stored, it.here, it.rows) for it in found.differences}
    assert told == {"ok": ("int64", "int32", 12), "extra": ("int64", "absent", 12), "path": ("absent", "double", 12)}


def test_a_changed_search_is_told_from_the_first_child_on(toys, tmp_path):
    # Epoch 0 tries the initial population, which the scale of perturbations has no part in; from epoch 1 on the best 5
    # come first, unchanged, and then their children.
    wrong = with_settings(file_of(toys, "behaviours"), tmp_path / "x", learning__scale=0.05)
    found = rerun(read_run(wrong), simulate=toy)
    assert [it.column for it in found.differences] == ["genotype"]
    assert found.place(found.differences[0].first) == {"epoch": 1, "slot": 5}


def test_a_changed_wobble_is_told_with_the_size_that_the_sine_gives_it(toys, tmp_path):
    wrong = with_settings(file_of(toys, "epochs"), tmp_path / "x", wobble__amplitude=0.31)
    told = {it.column: it for it in rerun(read_run(wrong), simulate=toy).differences}
    # Factors 1 + A sin(2 pi n/5) up to epoch 5: A = 0.3 stored and 0.31 here differ by 0.01 sin(2 pi/5) at most, and
    # in epochs 0 and 5 not at all.
    assert (told["mass"].rows, told["mass"].first) == (4, 1)
    assert told["mass"].largest == pytest.approx(0.01 * np.sin(2 * np.pi / 5), abs=1e-15)
    assert told["best"].first == 1


def test_a_changed_setting_of_a_robot_is_told_from_its_first_trial_on(robots, tmp_path):
    wrong = with_settings(file_of(robots, "trials"), tmp_path / "x", scene__gravity=101.0)
    found = {it.column: it for it in rerun(read_run(wrong), 1).differences}
    assert set(found) == {"performance"}
    assert (found["performance"].first, found["performance"].rows) == (0, 20)


def test_the_row_of_a_run_names_the_setting_itself(toys, tmp_path):
    wrong = with_settings(file_of(toys, "runs"), tmp_path / "x", trial__period=1.5)
    (told,) = rerun(read_run(wrong), simulate=toy).differences  # the toy takes no time
    assert told == Difference("trial.period", 1, 0, 1.0, 1.5, 0.5)


def test_another_kernel_is_told_even_where_the_bits_agree(toys, tmp_path):
    other = rewritten(file_of(toys, "epochs"), tmp_path / "x", {"kernel": "0123456789abcdef", "libc": None})
    found = rerun(read_run(other), simulate=toy)
    assert found.agree
    here = provenance()
    assert found.changed == {"kernel": ("0123456789abcdef", here["kernel"]), "libc": ("", here["libc"])}
    assert found.provenance.keys() == here.keys() | {"schema_version"}


# --- a part --------------------------------------------------------------------------------------------------------


def test_the_first_epochs_alone_are_repeated_and_compared(toys, tmp_path):
    source, calls = file_of(toys, "epochs"), []

    def counting(*arguments, **settings):
        calls.append(1)
        return toy(*arguments, **settings)

    best = np.array(values(source, "best"))
    best[5] += 1.0
    run = read_run(rewritten(source, tmp_path / "x", best=best))
    assert rerun(run, 5, simulate=counting).agree
    assert len(calls) == 5
    found = rerun(run, 6, simulate=toy)
    assert (found.rows, [(it.column, it.first) for it in found.differences]) == (6, [("best", 5)])
    assert rerun(run, 1000, simulate=toy).epochs == 12


def test_the_row_of_a_run_cannot_be_compared_in_part(toys):
    run = read_run(file_of(toys, "runs"))
    with pytest.raises(StoreError, match=r"sums up all 12 epochs; give the run's file in epochs/"):
        rerun(run, 3, simulate=toy)
    assert rerun(run, 12, simulate=toy).agree


def test_a_file_of_several_runs_has_one_chosen(toys, tmp_path):
    folder = tmp_path / "results"
    shutil.copytree(toys, folder)
    compact(folder)
    for table in TABLES:
        (path,) = (folder / table / "condition=mass").iterdir()
        copy = shutil.copy(path, tmp_path / table)
        with pytest.raises(StoreError, match=r"holds seeds 0\.\.3; choose one with --seed"):
            read_run(path)
        with pytest.raises(StoreError, match=r"holds seeds 0\.\.3; there is no seed 4 in it"):
            read_run(path, 4)
        for seed in range(4):
            assert rerun(read_run(path, seed), simulate=toy).agree
            assert rerun(read_run(copy, seed), simulate=toy).changed == {}


def test_each_run_of_a_file_of_several_has_what_computed_it(toys, tmp_path):
    both = [pq.ParquetFile(file_of(toys, "epochs", seed=seed)).read() for seed in (1, 3)]
    sources = [{"kernel": "one", "seeds": [1]}, {"kernel": "three", "numpy": "3.0", "seeds": [3]}]
    about = both[0].schema.metadata | {
        b"wobblesim.seeds": b"[1, 3]",
        b"wobblesim.sources": json.dumps(sources).encode(),
    }
    pq.write_table(pa.concat_tables(both).replace_schema_metadata(about), tmp_path / "x", row_group_size=9)
    for seed, changed in ((1, {"kernel": "one"}), (3, {"kernel": "three", "numpy": "3.0"})):
        found = rerun(read_run(tmp_path / "x", seed), simulate=toy)
        assert found.agree
        assert {name: stored for name, (stored, _) in found.changed.items()} == changed


# --- refused -------------------------------------------------------------------------------------------------------

BAD = {
    "empty": (lambda content: b"", "cannot be read as Parquet"),
    "cut": (lambda content: content[:-1], "cannot be read as Parquet"),
    "half": (lambda content: content[: len(content) // 2], "cannot be read as Parquet"),
    "text": (lambda content: b"name: study\n", "cannot be read as Parquet"),
    "a flipped bit in a page": (lambda content: content[:700] + bytes([content[700] ^ 1]) + content[701:], "checksum"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_damaged_file_is_refused_in_one_sentence(toys, tmp_path, case):
    damage, message = BAD[case]
    (tmp_path / "x").write_bytes(damage(file_of(toys, "behaviours").read_bytes()))
    with pytest.raises(StoreError, match=message) as refused:
        read_run(tmp_path / "x")
    assert "\n" not in str(refused.value)


def test_a_foreign_parquet_file_is_refused(tmp_path):
    pq.write_table(pa.table({"a": [1, 2]}), tmp_path / "x")
    with pytest.raises(StoreError, match="was not written by wobblesim"):
        read_run(tmp_path / "x")


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"config": None}, "its metadata lack 'config'"),
        ({"seed": None}, "its metadata lack 'seed'"),
        ({"seed": "one"}, "invalid literal"),
        ({"seeds": "5"}, "not iterable"),
        ({"seeds": "[[0]]"}, "must be"),
        ({"seeds": "[1, 2"}, "Expecting ',' delimiter"),
        ({"table": "stars"}, "has no table stars"),
        ({"config": "[]"}, "its settings are not sound"),
        ({"config": "null"}, "its settings are not sound"),
        ({"config": "{"}, "Expecting property name"),
        ({"config": "[" * 100_000}, "maximum recursion depth"),
        ({"config": '{"physics": {"dt": -1}}'}, r"physics.dt: -1 is too small"),
        ({"config": '{"learning": {"epochs": 999999}}'}, "it has 12 rows of epochs, where its settings make 999,999"),
        ({"config": '{"log": "epochs"}', "table": "trials"}, "a run with the log epochs has no table trials"),
        ({"seeds": "[2]", "sources": "5"}, "not iterable"),
        ({"seeds": "[2]", "sources": '[{"kernel": "x"}]'}, "its metadata lack 'seeds'"),
    ],
)
def test_metadata_that_describe_no_run_are_refused_in_one_sentence(toys, tmp_path, about, message):
    wrong = rewritten(file_of(toys, "epochs"), tmp_path / "x", about)
    with pytest.raises(StoreError, match=message) as refused:
        read_run(wrong)
    assert "\n" not in str(refused.value)


def test_what_a_terminal_would_obey_is_spelt_out(toys, tmp_path):
    wrong = rewritten(file_of(toys, "epochs"), tmp_path / "x", {"condition": "\x1b[2Jmass", "kernel": "\x1b]0;x\x07"})
    run = read_run(wrong)
    assert (run.condition, run.provenance["kernel"]) == (r"\x1b[2Jmass", r"\x1b]0;x\x07")
    assert [it.column for it in rerun(run, simulate=toy).differences] == ["condition"]


def test_rows_of_another_run_than_the_metadata_say_are_refused(toys, tmp_path):
    wrong = rewritten(file_of(toys, "epochs"), tmp_path / "x", {"seed": "1"})
    with pytest.raises(StoreError, match="it has no rows of seed 1"):
        read_run(wrong)


def test_what_the_manifest_does_not_know_or_knows_otherwise_is_refused(toys, tmp_path):
    folder = tmp_path / "results"
    shutil.copytree(toys, folder)
    path = file_of(folder, "epochs")
    assert rerun(read_run(path), simulate=toy).agree
    rewritten(path, path)  # the same rows, other bytes
    with pytest.raises(StoreError, match=r"seed-2.parquet has .* bytes instead of .*; `wobblesim verify"):
        read_run(path)
    content = bytearray(file_of(toys, "epochs").read_bytes())
    content[-200] ^= 1  # in the footer, where no page's checksum is
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"is altered: its content is not what was written \(sha256\); `wobblesim"):
        read_run(path)
    foreign = file_of(folder, "epochs", seed=99)
    shutil.copy(file_of(toys, "epochs"), foreign)
    with pytest.raises(StoreError, match="is of no run: no line of the manifest names it"):
        read_run(foreign)
    (folder / MANIFEST).unlink()
    assert rerun(read_run(foreign), simulate=toy).agree  # a folder without a manifest knows nothing


def test_settings_that_the_simulator_refuses_are_told(robots, tmp_path):
    wrong = with_settings(file_of(robots, "epochs"), tmp_path / "x", physics__integrator="explicit")
    with pytest.raises(StoreError, match=r"cannot be repeated: .*stable"):
        rerun(read_run(wrong))


MUTANTS = """
import sys; sys.path[:0] = [".", "tests"]
from pathlib import Path
import numpy as np
from study.toy import toy
from wobblesim.study.errors import StoreError
from wobblesim.study.rerun import read_run, rerun

path, rng, read = Path(sys.argv[2]), np.random.default_rng(0), 0
content = Path(sys.argv[1]).read_bytes()
footer = int.from_bytes(content[-8:-4], "little") + 8
for _ in range(600):
    mutant = bytearray(content)
    for place in rng.integers(1, footer, rng.integers(1, 4)):
        mutant[-place] = rng.integers(256)
    path.write_bytes(mutant)
    try:
        rerun(read_run(path), simulate=toy)
        read += 1
    except StoreError as error:
        assert "\\n" not in str(error), error
print(read)
"""


def test_no_damage_of_a_footer_ends_the_process_or_makes_it_wait(toys, tmp_path):
    # A reader that asks pyarrow for the statistics of a column is ended by two of these (SIGABRT).
    command = [sys.executable, "-c", MUTANTS, file_of(toys, "epochs"), tmp_path / "x"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert (found.returncode, found.stderr) == (0, "")
    assert 0 < int(found.stdout) < 200  # measured 53 of 600 that can be read
