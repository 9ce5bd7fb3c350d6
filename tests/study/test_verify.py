"""`verify` finds every flipped bit and every missing, doubled or foreign file; `--repair` leaves what is sound."""

import json
import os
import random
import shutil
import threading
import time
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from study.toy import TABLES, StopAfter, content, slow_toy, study, toy

from wobblesim.analysis.tables import load
from wobblesim.commands import main
from wobblesim.study import verify as verify_module
from wobblesim.study.compact import compact
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.study.lock import Shard
from wobblesim.study.manifest import MANIFEST, read_manifest, sealed_all
from wobblesim.study.repair import repair
from wobblesim.study.store import CHECKPOINTS, CONFIG, QUARANTINE, Store, opened
from wobblesim.study.verify import verify

TWO_RUNS = ("conditions={fixed: {wobble: null}}", "learning.epochs=3", "learning.population=4", "learning.parents=2")


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


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Two runs of four files each."""
    folder = tmp_path_factory.mktemp("small")
    sweep(study(*TWO_RUNS, seeds="0..1"), folder, simulate=toy)
    return folder


def found(folder):
    """What is found, path by path."""
    return {finding.path: finding.what for finding in verify(folder).findings}


def flip(path, bit):
    damaged = bytearray(path.read_bytes())
    damaged[bit // 8] ^= 1 << bit % 8
    path.write_bytes(damaged)


def test_a_sound_folder_is_counted_and_left_alone(done):
    before = {path: path.stat().st_mtime_ns for path in done.rglob("*")}
    seen = verify(done)
    files = list(done.rglob("*.parquet"))
    assert (seen.findings, seen.pending, seen.writers) == ((), (), ())
    assert (seen.runs, seen.files) == (8, len(files)) == (8, 32)
    assert seen.bytes == sum(path.stat().st_size for path in files)
    assert seen.rows == sum(pq.read_metadata(path).num_rows for path in files) == 8 * (1 + 12 + 240 + 240)
    assert {path: path.stat().st_mtime_ns for path in done.rglob("*")} == before


# --- flipped bits --------------------------------------------------------------------------------------------------


def kinds_of_place(folder):
    """Where a bit may flip: (what, file, first byte, end)."""
    for path in sorted(folder.rglob("*.parquet")):
        length = path.stat().st_size
        footer = length - 8 - int.from_bytes(path.read_bytes()[-8:-4], "little")
        yield "data", path, 0, footer
        yield "footer", path, footer, length
    for name in (MANIFEST, CONFIG):
        yield name, folder / name, 0, (folder / name).stat().st_size


def check_flips(folder, number, seed):
    """Flip bits one at a time; all must be found, and none of a table may be read."""
    rng = random.Random(seed)
    places = {}
    for what, *place in kinds_of_place(folder):
        places.setdefault(what, []).append(place)
    for trial in range(number):
        what = list(places)[trial % len(places)]
        path, start, end = rng.choice(places[what])
        bit = rng.randrange(8 * start, 8 * end)
        flip(path, bit)
        told = [finding.path for finding in verify(folder).findings]
        assert told[0] == str(path.relative_to(folder)), f"bit {bit} of {path}"
        if what in ("data", "footer"):
            assert len(told) == 1
            with pytest.raises(StoreError, match=r"missing or damaged"):
                getattr(load(folder), path.relative_to(folder).parts[0])()
        flip(path, bit)
    assert verify(folder).findings == ()


@pytest.mark.parametrize("is_compact", [False, True], ids=["runs", "compacted"])
def test_every_flipped_bit_is_found_and_none_is_read(small, tmp_path, is_compact):  # CR-9
    folder = Path(shutil.copytree(small, tmp_path / "flipped"))
    if is_compact:
        compact(folder)
    check_flips(folder, 100, seed=9)


@pytest.mark.nightly
def test_every_one_of_many_flipped_bits_is_found(small, tmp_path):  # CR-9
    check_flips(Path(shutil.copytree(small, tmp_path / "flipped")), 20_000, seed=10)


@pytest.mark.nightly
def test_every_bit_of_the_manifest_matters(small, tmp_path):
    folder = Path(shutil.copytree(small, tmp_path / "flipped"))
    for bit in range(8 * (folder / MANIFEST).stat().st_size):
        flip(folder / MANIFEST, bit)
        assert read_manifest(folder).faults, f"bit {bit}"
        flip(folder / MANIFEST, bit)


# --- the manifest --------------------------------------------------------------------------------------------------


def lines_of(folder):
    return (folder / MANIFEST).read_bytes().splitlines(keepends=True)


def without(place):
    return lambda lines: lines[:place] + lines[place + 1 :]


TAMPERED = {
    "first line lost": without(0),
    "a line lost": without(4),
    "last line lost": without(-1),
    "a line doubled": lambda lines: [*lines[:5], *lines[4:]],
    "last line doubled": lambda lines: [*lines, lines[-1]],
    "lines swapped": lambda lines: [*lines[:4], lines[5], lines[4], *lines[6:]],
    "last line torn": lambda lines: [*lines[:-1], lines[-1][:-20]],
    "an empty line": lambda lines: [*lines[:4], b"\n", *lines[4:]],
    "all lost": lambda lines: [],
    "forged without a checksum": lambda lines: [b'{"kind": "lost", "condition": "mass", "seeds": [1]}\n', *lines],
}


@pytest.mark.parametrize("tamper", TAMPERED.values(), ids=TAMPERED)
def test_a_line_that_is_lost_doubled_or_moved_is_found_and_repaired(done, tamper):
    whole = content(done)
    (done / MANIFEST).write_bytes(b"".join(tamper(lines_of(done))))
    assert found(done)
    repaired = repair(done)
    assert repaired.before.findings
    assert {finding.path for finding in repaired.after.findings} <= {CONFIG}
    sweep(study(), done, simulate=toy)
    assert content(done) == whole
    assert found(done) == {}


def test_a_manifest_that_is_gone_is_a_finding_and_nothing_is_moved(done):
    (done / MANIFEST).unlink()
    assert found(done)[MANIFEST] == "is missing"
    with pytest.raises(StoreError, match="has lost its manifest"):
        repair(done)
    assert len(list(done.rglob("*/condition=*/seed-*.parquet"))) == 32


def test_what_a_condition_is_is_known_from_its_files_if_its_line_is_lost(done):
    flip(done / MANIFEST, 8 * 200)
    assert found(done) == {MANIFEST: "line 1: is damaged"}
    assert set(read_manifest(done).conditions) == {"fixed", "mass"}
    assert load(done).runs("condition")["condition"].notna().all()
    with pytest.raises(StoreError, match=r"learning.rate +0.1 +0.2"):
        sweep(study("learning.rate=0.2"), done, simulate=toy)
    assert repair(done).missing == 0
    assert verify(done).findings == ()
    assert sweep(study(), done, simulate=toy).present == 8


def test_a_line_of_a_shard_is_checked_as_well(tmp_path):
    for number in (1, 2):
        sweep(study(), tmp_path, simulate=toy, shard=Shard(number, 2))
    assert found(tmp_path) == {}
    assert verify(tmp_path).runs == 8
    shard = tmp_path / "manifest-2-of-2.jsonl"
    flip(shard, 8 * (shard.stat().st_size - 100))
    told = found(tmp_path)
    assert told.pop(shard.name) == f"line {len(shard.read_bytes().splitlines())}: is damaged"
    assert len(told) == 4
    assert set(told.values()) == {"belongs to no run: no line of the manifest names it"}


def forged(folder, change):
    """Write the manifest anew after a change of its run of seed 1, as somebody who knows its form could."""
    lines = [json.loads(line) for line in lines_of(folder)]
    for line in lines:
        if line["kind"] == "run" and line["seed"] == 1:
            change(line)
        line.pop("after"), line.pop("check")
    (folder / MANIFEST).write_bytes(sealed_all(lines)[0])


@pytest.mark.parametrize(
    ("change", "path", "what"),
    [
        (lambda line: line["files"]["epochs"].update(rows=13), "epochs/{}", "12 rows where the manifest says 13"),
        (lambda line: line.update(diverged=99), "runs/{}", "says of seed 1 what the manifest does not say"),
        (lambda line: line["files"].pop("trials"), MANIFEST, "names other tables of {}, seed 1"),
        (lambda line: line.update(seed=7), "runs/{}", "says another seeds of itself"),
    ],
)
def test_a_manifest_that_says_what_the_files_do_not_is_found(done, change, path, what):
    forged(done, change)
    told = found(done)
    assert any(
        what.format(condition) in told.get(path.format(f"condition={condition}/seed-1.parquet"), "")
        for condition in ("fixed", "mass")
    )


def test_another_kernel_or_another_condition_in_a_file_is_found(done):
    lines = [json.loads(line) for line in lines_of(done)]
    lines[0]["kernel"] = "another"
    lines[1]["config"]["learning"]["rate"] = 0.2
    for line in lines:
        line.pop("after"), line.pop("check")
    (done / MANIFEST).write_bytes(sealed_all(lines)[0])
    told = found(done)
    assert len(told) == 32
    assert {what for path, what in told.items() if "fixed" in path} == {
        "says another kernel of itself than the manifest"
    }
    assert {what for path, what in told.items() if "mass" in path} == {
        "says another config of itself than the manifest"
    }


# --- files ---------------------------------------------------------------------------------------------------------

A_FILE = "trials/condition=mass/seed-2.parquet"


def remove(path):
    path.unlink()


def double(path):
    shutil.copy(path, path.with_name("seed-2-copy.parquet"))


def double_with_other_bytes(path):
    """The same run, packed otherwise."""
    pq.write_table(pq.read_table(path, partitioning=None), path.with_name("seed-02.parquet"))


def link(path):
    elsewhere = path.parents[2] / "elsewhere.parquet"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def pipe(path):
    path.unlink()
    os.mkfifo(path)


HARMS = {
    "missing": (remove, "", "is missing"),
    "cut to nothing": (lambda path: path.write_bytes(b""), "", "has 0 bytes instead of"),
    "longer": (lambda path: path.write_bytes(path.read_bytes() + b"x"), "", "bytes instead of"),
    "another's": (lambda path: shutil.copy(path.with_name("seed-1.parquet"), path), "", "instead of"),
    "copied": (double, "seed-2-copy.parquet", f"is a copy of {A_FILE}"),
    "doubled": (double_with_other_bytes, "seed-02.parquet", f"holds a run that {A_FILE} holds"),
    "foreign text": (lambda path: path.with_name("notes.txt").write_text("x"), "notes.txt", "is foreign"),
    "foreign name": (lambda path: path.with_name("a\x1b[2J").write_text("x"), r"a\x1b[2J", "is foreign"),
    "foreign table": (lambda path: shutil.copy(__file__, path.with_name("seed-9.parquet")), "seed-9.parquet", "is for"),
    "foreign folder": (lambda path: (path.parent / "a").mkdir() or (path.parent / "a" / "b").touch(), "a/b", "is for"),
    "a link": (link, "", "is a link"),
    "a pipe": (pipe, "", "is a device, pipe or socket"),
}


@pytest.mark.parametrize(("harm", "name", "what"), HARMS.values(), ids=HARMS)
def test_what_is_missing_doubled_or_foreign_is_found_and_repaired(done, harm, name, what):
    whole = content(done)
    harm(done / A_FILE)
    told = found(done)
    path = f"{A_FILE.rpartition('/')[0]}/{name}" if name else A_FILE
    assert list(told) == [path]
    assert what in told[path]
    repaired = repair(done)
    assert repaired.after.findings == ()
    assert repaired.missing == (not name)
    assert load(done).trials("seed").shape[0] == 240 * (8 - repaired.missing)
    assert sweep(study(), done, simulate=toy).done == repaired.missing
    assert content(done) == whole
    assert verify(done).findings == ()


CUTS = [0, 1, 0.5, -1]
OTHER_CUTS = [
    pytest.param(table, left, marks=pytest.mark.nightly)
    for place, table in enumerate(TABLES)
    for left in CUTS[:place] + CUTS[place + 1 :]
]


@pytest.mark.parametrize(("table", "left"), [*zip(TABLES, CUTS, strict=True), *OTHER_CUTS])
def test_a_partial_file_is_found_named_put_aside_and_redone(done, table, left):  # CR-8
    whole, path = content(done), done / table / "condition=fixed" / "seed-3.parquet"
    before = path.read_bytes()
    path.write_bytes(before[: int(left * len(before)) if left == 0.5 else left])
    name = str(path.relative_to(done))
    assert "bytes instead of" in found(done)[name]
    with pytest.raises(StoreError, match=f"{path} is missing or damaged"):
        getattr(load(done), table)()
    said = []
    assert sweep(study(), done, simulate=toy, progress=said.append).done == 1
    assert any(str(path) in told.message and QUARANTINE in told.message for told in said if told.kind == "note")
    assert (done / QUARANTINE / name).stat().st_size < len(before)
    assert content(done) == whole
    assert found(done) == {}


def test_a_folder_of_a_dataset_that_is_a_link_is_found(done, tmp_path):
    (done / "epochs").rename(tmp_path / "elsewhere")
    (done / "epochs").symlink_to(tmp_path / "elsewhere")
    assert found(done)["epochs"] == "is a link, where a sweep puts plain files only"


@pytest.mark.parametrize("harm", [lambda path: path.write_text("name: other\n"), remove])
def test_a_configuration_that_no_sweep_wrote_is_found_and_written_anew(done, harm):
    harm(done / CONFIG)
    assert list(found(done)) == [CONFIG]
    repair(done)
    sweep(study(), done, simulate=toy)
    assert found(done) == {}


def test_a_checkpoint_that_cannot_be_read_is_found(tmp_path):
    sweep(study(), tmp_path, simulate=toy, stop=StopAfter(3))
    assert found(tmp_path) == {}
    states = sorted((tmp_path / CHECKPOINTS).rglob("*.npz"))
    name = states[0].parent.parent.relative_to(tmp_path).as_posix()
    listing = states[0].read_bytes().index(b"PK\x01\x02")
    for bit in (8 * (listing + 8), 8 * (listing + 10), 8 * (states[0].stat().st_size // 2)):  # "encrypted", "packed"
        flip(states[0], bit)
        assert found(tmp_path) == {name: "holds 1 of 1 that cannot be read"}
        flip(states[0], bit)
    flip(states[0], 8 * (states[0].stat().st_size // 2))
    assert repair(tmp_path).after.findings == ()


# --- repair --------------------------------------------------------------------------------------------------------


def test_repair_leaves_all_that_is_sound_and_the_sweep_computes_the_rest_with_the_same_bits(done):
    whole = content(done)
    for name in ("runs/condition=mass/seed-0", "behaviours/condition=mass/seed-3", "epochs/condition=fixed/seed-1"):
        flip(done / f"{name}.parquet", 8 * 3000)
    flip(done / MANIFEST, 8 * (done / MANIFEST).read_bytes().index(b'"condition": "mass", "seed": 2'))
    with pytest.raises(StoreError, match="--repair"):
        load(done).runs()
    repaired = repair(done)
    assert (repaired.missing, repaired.after.runs, repaired.after.findings) == (4, 4, ())
    assert len(load(done).runs()) == 4
    kept = content(done)
    assert kept == {path: rows for path, rows in whole.items() if path in kept}
    outcome = sweep(study(), done, simulate=toy)
    assert (outcome.present, outcome.done) == (4, 4)
    assert content(done) == whole


def test_repair_of_a_compacted_condition_costs_its_runs_and_no_other(done):
    whole = content(done)
    sweep(study(seeds="4"), done, simulate=toy)
    both = load(done).epochs()
    compact(done)
    sweep(study(seeds="5"), done, simulate=toy)
    flip(next((done / "epochs" / "condition=mass").glob("seeds-*")), 8 * 3000)
    assert repair(done).missing == 5
    assert sorted(load(done).runs("seed", "condition").value_counts("condition")) == [1, 6]
    sweep(study(seeds="0..5"), done, simulate=toy)
    rows = load(done).epochs()
    assert rows[rows["seed"] < 5].reset_index(drop=True).equals(both)
    assert found(done) == {}
    assert len(whole) == 32


def test_repair_of_a_sound_folder_changes_nothing(done):
    before = {path: path.stat().st_ino for path in done.rglob("*") if path.is_file()}
    assert repair(done).done == ()
    assert {path: path.stat().st_ino for path in done.rglob("*") if path.is_file()} == before


def test_repair_refuses_while_somebody_writes(done):
    (done / A_FILE).unlink()
    with opened(done), pytest.raises(StoreError, match="in use by process"):
        repair(done)


# --- while a sweep runs --------------------------------------------------------------------------------------------


def test_nothing_is_found_while_a_sweep_runs(tmp_path):
    sweeping = threading.Thread(
        target=sweep, args=(study("learning.epochs=6"), tmp_path), kwargs={"simulate": slow_toy(0.01)}
    )
    sweeping.start()
    looks = 0
    while sweeping.is_alive():
        if (tmp_path / MANIFEST).exists():
            looks += 1
            assert verify(tmp_path).findings == ()
    sweeping.join()
    assert looks > 3
    assert verify(tmp_path).runs == 8


@pytest.fixture
def held_up(monkeypatch):
    """Makes a process wait between moving files to their places and saying so in the manifest."""
    reached, go_on = threading.Event(), threading.Event()
    append = Store._append

    def slow(store, lines):
        if any(line["kind"] in ("run", "compact") for line in lines):
            reached.set()
            go_on.wait(10)
        append(store, lines)

    monkeypatch.setattr(Store, "_append", slow)
    return reached, go_on


WORKS = {"a sweep": lambda folder: sweep(study(seeds="0..5"), folder, simulate=toy), "compacting": compact}


@pytest.mark.parametrize("work", WORKS.values(), ids=WORKS)
def test_a_file_whose_line_is_about_to_come_is_no_finding(done, held_up, monkeypatch, work):
    reached, go_on = held_up
    worker = threading.Thread(target=work, args=(done,))
    worker.start()
    assert reached.wait(10)
    seen = verify(done, patience=0.0)
    assert (seen.findings, len(seen.writers)) == ((), 1)
    assert len(seen.pending) >= 4
    monkeypatch.setattr(verify_module, "verify", partial(verify, patience=0.0))
    assert "not judged" in CliRunner().invoke(main, ["verify", str(done)]).output
    threading.Timer(0.3, go_on.set).start()
    seen = verify(done)  # the line comes while it waits
    assert seen.findings == ()
    worker.join()
    assert (verify(done).findings, verify(done).pending) == ((), ())


def test_what_is_wrong_is_found_while_somebody_writes(done):
    with opened(done):
        (done / A_FILE).unlink()
        started = time.monotonic()
        assert [finding.path for finding in verify(done, patience=0.2).findings] == [A_FILE]
        assert time.monotonic() - started > 0.2


# --- the command ---------------------------------------------------------------------------------------------------


def test_the_command_says_what_it_found_and_what_to_do(done):
    sound = CliRunner().invoke(main, ["verify", str(done)])
    assert (sound.exit_code, sound.stderr) == (0, "")
    assert sound.stdout.startswith("sound: 8 runs, 32 files, 3,944 rows, 0.4 MB; 0 findings (")
    flip(done / A_FILE, 8 * 4000)
    called = CliRunner().invoke(main, ["verify", str(done)])
    assert called.exit_code == 3
    line, summary = called.stdout.splitlines()
    assert line.startswith(f"{A_FILE}: is altered")
    assert "`wobblesim verify --repair` puts it aside" in line
    assert summary.startswith("sound: 7 runs, 31 files")
    data = json.loads(CliRunner().invoke(main, ["verify", "--json", str(done)]).stdout)
    assert (data["sound"], data["files"], [it["path"] for it in data["findings"]]) == (False, 31, [A_FILE])
    mended = CliRunner().invoke(main, ["verify", "--repair", "--json", str(done)])
    assert mended.exit_code == 3
    assert json.loads(mended.stdout)["repaired"]["missing"] == 1
    assert CliRunner().invoke(main, ["verify", str(done)]).exit_code == 0


def test_a_folder_without_results_is_bad_usage(tmp_path):
    called = CliRunner().invoke(main, ["verify", str(tmp_path)])
    assert (called.exit_code, called.stdout) == (2, "")
    assert called.stderr == f"{tmp_path} holds no results; give the folder that a sweep has written\n"
