"""A million runs are planned, and ten thousand stored, without anyone waiting for it."""

import gc
import json
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from config.apart import Timed, quickest
from study.toy import study as toy_study
from study.toy import toy

from wobblesim.config import dump, parse_config
from wobblesim.study import files, store
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest
from wobblesim.study.plan import plan, study
from wobblesim.study.store import opened

TESTS = Path(__file__).parents[1]


def grid(amplitudes: int, periods: int, seeds: int) -> str:
    """A grid of so many conditions; it takes the place of the robot's default wobble."""
    return textwrap.dedent(f"""
        name: big
        seeds: 0..{seeds - 1}
        robot: {{kind: starfish, arms: 3, sections: 2}}
        learning: {{epochs: 2}}
        wobble: {{dimension: mass, amplitude: 0.1, period: 25}}
        sweep:
          wobble.amplitude: {[round(0.001 * (place + 1), 4) for place in range(amplitudes)]}
          wobble.period: {[place + 3 for place in range(periods)]}
        """)


LAYOUTS = {"10,000 conditions": (100, 100, 100), "1,000 conditions": (100, 10, 1000), "one condition": (1, 1, 10**6)}

PLAN = """
import json, resource, sys, time
from pathlib import Path
from wobblesim.config import load_config
from wobblesim.study.preview import preview
seen = preview(load_config(sys.argv[1]), Path(sys.argv[2]), workers=2, threads=1)
runs = sum(len(group.seeds) for group in seen.plan)
usage = resource.getrusage(resource.RUSAGE_SELF)
assert runs == sum(row["missing"] for row in seen.rows())
status = Path("/proc/self/status")  # beside it ru_maxrss counts what the process had that started this one
kilobytes = usage.ru_maxrss / 1024
if status.exists():
    kilobytes = int(status.read_text().partition("VmHWM:")[2].split()[0])
print(json.dumps({"runs": runs, "seconds": usage.ru_utime + usage.ru_stime, "megabytes": kilobytes / 1024}))
"""


def planned(path: Path, folder: Path) -> Timed:
    """Plan in a process of its own: processor time from its start; runs, and the most memory it had."""
    told = json.loads(output(PLAN, path, folder))
    return Timed(told.pop("seconds"), told)


def output(code: str, *arguments: Path) -> str:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    return found.stdout


@pytest.mark.parametrize(
    "layout", ["10,000 conditions", *(pytest.param(l, marks=pytest.mark.nightly) for l in list(LAYOUTS)[1:])]
)
def test_a_million_runs_are_planned_in_seconds_and_300_megabytes(tmp_path, layout):
    # Processor time, with the start of Python and all imports: the time on the clock if nothing else is at work.
    path = tmp_path / "big.yaml"
    path.write_text(grid(*LAYOUTS[layout]))
    found = quickest(lambda: planned(path, tmp_path / "none"), within=4)
    assert found.told["runs"] == 10**6
    assert found.seconds < 4  # measured 1.73, 1.13 and 1.11 on a busy machine; 2 is promised, see benchmarks/
    assert found.told["megabytes"] < 300  # measured 208, 192 and 230


def test_groups_of_unequal_conditions_are_not_searched_for(tmp_path):
    # one condition lacks 200,000 seeds, the others one each: going through all conditions for every group took minutes
    whole = study(parse_config(grid(100, 20, 200_000 // 2000)))
    part = dict.fromkeys(whole.conditions, (0,))
    part[next(iter(part))] = tuple(range(200_000))
    lopsided = type(whole)(whole.conditions, whole.seeds, part)
    begun = time.process_time()
    groups = list(plan(lopsided, (), (), workers=1, threads=1))
    assert time.process_time() - begun < 2  # measured 0.07
    assert sum(len(group.seeds) for group in groups) == 200_000 + 1999


def test_settings_of_ten_thousand_conditions_are_compared_in_a_second(tmp_path):
    laid_out = study(parse_config(grid(100, 100, 1)))
    with opened(tmp_path) as held:
        held.declare(laid_out.written, laid_out.seeds, "")
    with opened(tmp_path) as held:
        held.manifest.runs |= {(condition, 0): None for condition in laid_out.conditions}
        begun = time.process_time()
        held.declare(laid_out.written, laid_out.seeds, "")
        assert time.process_time() - begun < 1  # measured 0.04
    assert (tmp_path / "manifest.jsonl").read_bytes().count(b'"kind": "condition"') == 10_000


# --- ten thousand runs ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """A folder of 10,000 runs: the files of all but one are as long as they should be, and empty."""
    one = tmp_path_factory.mktemp("one")
    sweep(parse_config(grid(1, 1, 1)), one, simulate=toy)
    (run,) = read_manifest(one).runs.values()
    folder, config = tmp_path_factory.mktemp("full"), parse_config(grid(10, 10, 100))
    laid_out = study(config)
    with opened(folder) as held:
        held.declare(laid_out.written, laid_out.seeds, dump(config))
        lines = []
        for condition in laid_out.conditions:
            for table in run.files:
                (folder / table / f"condition={condition}").mkdir(parents=True)
            for seed in laid_out.seeds:
                paths = {table: f"{table}/condition={condition}/seed-{seed}.parquet" for table in run.files}
                for table, path in paths.items():
                    with (folder / path).open("wb") as file:
                        file.truncate(run.files[table].bytes)
                of_run = {table: run.files[table]._asdict() | {"path": path} for table, path in paths.items()}
                told = {"status": "ok", "diverged": 0, "refined": 0}
                lines.append({"kind": "run", "condition": condition, "seed": seed, **told, "files": of_run})
        held._append(lines)
    return folder


def test_a_folder_of_ten_thousand_runs_opens_in_a_second(full):
    def open_it() -> Timed:
        begun = time.process_time()
        with opened(full) as held:
            seconds = time.process_time() - begun
            assert len(held.manifest.runs) == 10_000
            assert held.lost == []
        return Timed(seconds)

    gc.freeze()  # the collector would go through all that the tests before have left, which takes longer than opening
    assert quickest(open_it, within=1).seconds < 1  # measured 0.37
    gc.unfreeze()


def test_the_status_of_ten_thousand_runs_is_told_in_a_second_without_the_simulator(full):
    code = """
        import resource, sys
        from wobblesim.commands import main
        main(["status", sys.argv[1]], standalone_mode=False)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        print(usage.ru_utime + usage.ru_stime, "numba" in sys.modules)
        """

    def tell() -> Timed:
        told = output(code, full)
        assert "amplitude-0.001_period-3 " in told
        seconds, has_numba = told.splitlines()[-1].split()
        assert has_numba == "False"
        return Timed(float(seconds))

    # with the start of Python and all imports: measured 0.50 on one machine; 1.1 on a slower one, told as 0.5
    assert quickest(tell, within=1).seconds < 1


# --- what a run costs besides its time -----------------------------------------------------------------------------


def test_every_file_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    events, fsync, replace = [], os.fsync, Path.replace

    def flushed(handle):
        events.append(("flush", str(Path(f"/proc/self/fd/{handle}").readlink())))
        fsync(handle)

    def moved(source, target):
        events.append(("move", str(source), str(target)))
        return replace(source, target)

    if not Path("/proc/self/fd").exists():
        pytest.skip("needs to see which file a number stands for")
    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(Path, "replace", moved)
    sweep(toy_study(seeds="0..7"), tmp_path, simulate=toy, threads=1)
    moves = [event for event in events if event[0] == "move" and event[1].endswith(".parquet")]
    assert len(moves) == 2 * 8 * 4
    for event in moves:
        at = events.index(event)
        assert ("flush", event[1]) in events[:at]
        assert ("flush", str(Path(event[2]).parent)) in events[at:]
    # one line of the manifest after another is on the disk: one flush a group, and one when the study is declared
    groups = len(plan(study(toy_study(seeds="0..7")), (), (), 1, 1))
    assert events.count(("flush", str(tmp_path / "manifest.jsonl"))) == groups + 1


def test_all_columns_are_packed_as_the_format_says(tmp_path):
    sweep(toy_study(), tmp_path, simulate=toy)
    for path in tmp_path.rglob("*.parquet"):
        footer = pq.read_metadata(path)
        kinds = {}
        packed = "UNCOMPRESSED" if footer.num_rows == 1 else "ZSTD"
        for place in range(footer.num_columns):
            column = footer.row_group(0).column(place)
            assert column.compression == packed, column.path_in_schema
            kinds.setdefault(column.physical_type, []).append(set(column.encodings))
        assert all("BYTE_STREAM_SPLIT" in encodings for encodings in kinds["DOUBLE"])
        assert all("RLE_DICTIONARY" in encodings for encodings in kinds["BYTE_ARRAY"])
        assert not any(
            "RLE_DICTIONARY" in encodings for kind in ("INT32", "INT64") for encodings in kinds.get(kind, [])
        )


def test_a_write_error_in_any_thread_ends_the_sweep_with_its_reason(tmp_path, monkeypatch):
    write = files.write_flushed

    def refused(path, content, told=None):
        if path.name == "epochs-2.parquet":
            raise files.not_written(path, OSError(28, "No space left on device"))
        write(path, content, told)

    with monkeypatch.context() as patch:
        patch.setattr(files, "write_flushed", refused)
        with pytest.raises(store.StoreError, match=r"epochs-2\.parquet: no space left on device"):
            sweep(toy_study(), tmp_path, simulate=toy)
    assert len(read_manifest(tmp_path).runs) < 8
    sweep(toy_study(), tmp_path, simulate=toy)
    assert len(read_manifest(tmp_path).runs) == 8


@pytest.mark.nightly  # 40 s, and a matter of how busy the machine is
def test_ten_thousand_tiny_runs_cost_less_than_5_ms_each(tmp_path):
    sys.path.insert(0, str(TESTS.parent / "benchmarks"))
    from overhead import measure

    # measured 4.9 and 5.2 for 1,000 runs at a load of 2 to 3 on two cores, 12.3 for 10,000 at a load of 9
    assert measure(100, 100, tmp_path).milliseconds < 5
