"""Damaged results folders end in an error or a finding: no crash, no traceback, not much memory, not long (SE-8).

A case damages one file of a small folder and gives the folder to all that reads it. The cases of a test run in worker
processes, many in each: a crash of a library written in C would take the tests with it.
"""

import contextlib
import faulthandler
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from study.toy import TABLES, StopAfter, study, toy

from wobblesim.study.compact import compact
from wobblesim.study.execute import sweep
from wobblesim.study.store import CHECKPOINTS, CONFIG

ROOT = Path(__file__).parents[2]

SMALL = ("learning.epochs=2", "learning.population=4", "learning.parents=2", "conditions={fixed: {wobble: null}}")

SECONDS, BYTES = 5, 2**30
"""What one case may take."""

WORKERS = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A compacted condition with a run beside, and one in work."""
    folder = tmp_path_factory.mktemp("fuzz") / "origin"
    sweep(study(*SMALL, seeds="0..1"), folder, simulate=toy)
    compact(folder)
    sweep(study(*SMALL, seeds="2"), folder, simulate=toy)
    sweep(study(*SMALL, seeds="3"), folder, simulate=toy, stop=StopAfter(1))
    assert list((folder / CHECKPOINTS).rglob("*.npz"))
    return folder


def run(folder, tmp_path, kinds, cases, first=0):
    """Run cases, dealt to workers; return what they say in the end."""
    code = "import sys; from study.test_fuzz import work; work(*sys.argv[1:])"
    env = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
        "ARROW_DEFAULT_MEMORY_POOL": "system",
    }
    workers = []
    for number in range(WORKERS):
        arguments = [folder, tmp_path / str(number), ",".join(kinds), first + number, first + cases, WORKERS]
        workers.append(
            subprocess.Popen(
                [sys.executable, "-c", code, *map(str, arguments)],
                env=env,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
    ended = [(*worker.communicate(), worker.returncode) for worker in workers]
    for number, (_, errors, code) in enumerate(ended):
        assert code == 0, f"{(tmp_path / f'{number}.case').read_text()}: {errors[-3000:]}"
    return [json.loads(output) for output, _, _ in ended]


def check(told, cases):
    """Refuse what workers say if anything went otherwise than it should."""
    assert [problem for worker in told for problem in worker["problems"]] == []
    assert sum(worker["cases"] for worker in told) == cases
    assert max(worker["seconds"] for worker in told) < SECONDS
    assert max(worker["bytes"] for worker in told) < BYTES


KINDS = ("parquet", "sealed parquet", "manifest", "forged manifest", "config", "checkpoint")


def test_damaged_files_end_in_an_error_or_a_finding(folder, tmp_path):  # SE-8
    check(run(folder, tmp_path, KINDS, 60), 60)


@pytest.mark.nightly
def test_many_damaged_files_end_in_an_error_or_a_finding(folder, tmp_path):  # SE-8
    check(run(folder, tmp_path, KINDS, 50_000, first=1000), 50_000)


# --- a worker ------------------------------------------------------------------------------------------------------


def work(origin, scratch, kinds, first, end, step):
    """Run every `step`-th case and print what came of them; the process dies of a case that takes too long."""
    origin, scratch = Path(origin), Path(scratch)
    problems, slowest, count = [], 0.0, 0
    faulthandler.enable()
    limit = memory()[0] + BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for case in range(int(first), int(end), int(step)):
        kind = kinds.split(",")[case % len(kinds.split(","))]
        scratch.with_suffix(".case").write_text(f"case {case}, {kind}")
        faulthandler.dump_traceback_later(SECONDS, exit=True)
        started = time.monotonic()
        problems += [f"case {case}, {kind}: {problem}" for problem in problems_of(origin, scratch, kind, case)]
        slowest = max(slowest, time.monotonic() - started)
        faulthandler.cancel_dump_traceback_later()
        count += 1
    print(json.dumps({"cases": count, "problems": problems, "seconds": slowest, "bytes": memory()[1]}))


def memory():
    """Bytes of address space now, and of memory at most."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    # ru_maxrss also counts what the process had that started this one
    most = int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
    return pages * resource.getpagesize(), most * 1024


def problems_of(origin, scratch, kind, case):
    """Damage a folder, give it to all that reads it, and say what went otherwise than it should."""
    rng = random.Random(case)
    shutil.rmtree(scratch, ignore_errors=True)
    shutil.copytree(origin, scratch)
    if not DAMAGES[kind](scratch, rng):
        return []
    # What a checkpoint holds is in its arrays, which have checksums; other bytes of it may say nothing.
    is_altered = kind in ("parquet", "manifest", "config")
    return [*read_all(scratch), *commands(scratch, is_altered)]


def read_all(folder):
    from wobblesim.analysis.statistics import summary
    from wobblesim.analysis.tables import load
    from wobblesim.study.errors import StoreError

    for what in (*TABLES, "summary"):
        try:
            with contextlib.suppress(StoreError):
                results = load(folder)
                summary(results) if what == "summary" else getattr(results, what)()
        except BaseException as error:
            yield f"load, {what}: {error!r}"


def commands(folder, is_altered):
    from click.testing import CliRunner

    from wobblesim.commands import main

    for name in ("status", "verify", "compact"):
        result = CliRunner().invoke(main, [name, str(folder)])
        if result.exit_code not in (0, 2, 3) or not isinstance(result.exception, SystemExit | None):
            yield f"{name} ends with {result.exit_code}: {result.exception!r}"
        if name == "verify" and is_altered and result.exit_code != 3:
            yield f"verify finds nothing: {result.output}"


# --- damage --------------------------------------------------------------------------------------------------------


def damage_file(path, rng, start=0):
    """Damage the bytes of a file from `start` on; False if they are as they were."""
    content = path.read_bytes()
    damaged = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        if damaged:
            rng.choice(DAMAGES_OF_BYTES)(damaged, rng, min(start, len(damaged) - 1))
    path.write_bytes(damaged)
    return damaged != content


def place(content, rng, start):
    return rng.randrange(start, max(len(content), start + 1))


def flip(content, rng, start):
    content[place(content, rng, start)] ^= 1 << rng.randrange(8)


def random_byte(content, rng, start):
    content[place(content, rng, start)] = rng.randrange(256)


def extreme(content, rng, start):
    where = place(content, rng, start)
    content[where : where + rng.choice((1, 4, 8))] = rng.choice((b"\xff", b"\x7f", b"\0", b"\x80")) * rng.choice(
        (1, 4, 8)
    )


def cut(content, rng, start):
    del content[place(content, rng, start) :]


def cut_out(content, rng, start):
    where = place(content, rng, start)
    del content[where : where + rng.choice((1, 2, 16, 500))]


def insert(content, rng, start):
    where = place(content, rng, start)
    content[where:where] = rng.randbytes(rng.choice((1, 2, 16, 500)))


def double(content, rng, start):
    where = place(content, rng, start)
    content[where:where] = content[where : where + rng.choice((1, 16, 500))]


def zeros(content, rng, start):
    where = place(content, rng, start)
    span = len(content[where : where + rng.choice((16, 500))])
    content[where : where + span] = bytes(span)


DAMAGES_OF_BYTES = (flip, random_byte, extreme, cut, cut_out, insert, double, zeros)


def damage_table(folder, rng):
    """Damage a table, half of the time in its footer; return its path."""
    path = rng.choice(sorted(folder.rglob("condition=*/*.parquet")))
    content = path.read_bytes()
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    return path if damage_file(path, rng, footer if rng.random() < 0.5 else 0) else None


def damage_sealed_table(folder, rng):
    """Damage a table, and have the manifest say that this is what was written."""
    import hashlib

    path = damage_table(folder, rng)
    if path:
        content, name = path.read_bytes(), str(path.relative_to(folder))
        known = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        seal(
            folder, lambda line: [file.update(known) for file in line.get("files", {}).values() if file["path"] == name]
        )
    return path


def seal(folder, change):
    """Change the lines of the manifest, and write them anew with their checksums."""
    from wobblesim.study.manifest import MANIFEST, sealed_all

    lines = [json.loads(line) for line in (folder / MANIFEST).read_bytes().splitlines()]
    for line in lines:
        change(line)
    lines = [{key: line[key] for key in line if key not in ("after", "check")} for line in lines]
    (folder / MANIFEST).write_bytes(sealed_all(lines)[0])


ODD = (
    None, True, -1, 0, 1.5, 2**63, 10**400, 1e308, float("nan"), "", "x" * 1000, "..", "../../x", "\0", "é\ud800",
    [], {}, [[]], [1, "a"], {"a": {}},
)  # fmt: skip


def forge(folder, rng):
    """Change something in a line of the manifest, as somebody could who knows its form."""
    chosen = [rng.randrange(7) for _ in range(rng.choice((1, 1, 3)))]
    number = iter(range(100))

    def change(line):
        if next(number) in chosen:
            parent, key = rng.choice(list(leaves(line)))
            if rng.random() < 0.2:
                del parent[key]
            else:
                parent[key] = rng.choice(ODD)

    seal(folder, change)
    return True


def leaves(tree):
    """Where each value of a tree is."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from leaves(value)


def damage_checkpoint(folder, rng):
    return damage_file(rng.choice(sorted((folder / CHECKPOINTS).rglob("*.npz"))), rng)


DAMAGES = {
    "parquet": damage_table,
    "sealed parquet": damage_sealed_table,
    "manifest": lambda folder, rng: damage_file(folder / "manifest.jsonl", rng),
    "forged manifest": forge,
    "config": lambda folder, rng: damage_file(folder / CONFIG, rng),
    "checkpoint": damage_checkpoint,
}
