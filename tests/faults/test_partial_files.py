"""Files are cut (CR-8) or touched, the clock is wrong (CR-13), the study is another one (CR-10)."""

import datetime
import os
import re
import shutil
import time

import pytest
from click.testing import CliRunner
from faults.scenarios import check_sound, read
from study.toy import TABLES, StopAfter, study, toy

from wobblesim.commands import main
from wobblesim.study import store as store_module
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep
from wobblesim.study.files import damage, read_about, read_tables
from wobblesim.study.manifest import MANIFEST, read_manifest
from wobblesim.study.store import CHECKPOINTS, CONFIG, QUARANTINE

LENGTHS = {"0 bytes": lambda n: 0, "1 byte": lambda n: 1, "half": lambda n: n // 2, "n - 1 bytes": lambda n: n - 1}

SMALL = ("learning.epochs=4", "log=behaviours")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished toy study of 4 runs."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(study(*SMALL, seeds="0..1"), folder, simulate=toy)
    return folder


@pytest.fixture
def done(whole, tmp_path):
    """A copy of it."""
    return shutil.copytree(whole, tmp_path / "done")


def again(folder, *settings):
    """The same command, and what it notes."""
    said = []
    outcome = sweep(study(*SMALL, *settings, seeds="0..1"), folder, simulate=toy, progress=said.append)
    return outcome, [told.message for told in said if told.kind == "note"]


def cut(path, left):
    content = path.read_bytes()
    path.write_bytes(content[: LENGTHS[left](len(content))])
    return path.read_bytes()


# --- CR-8 ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("left", LENGTHS)
@pytest.mark.parametrize("table", TABLES)
def test_a_cut_file_is_put_aside_named_and_its_run_computed_again(done, whole, table, left, injected):
    file = read_manifest(done).files(table)[2]
    kept = cut(done / file.path, left)
    with pytest.raises(StoreError, match="is missing or damaged"):
        read_tables(done, [file])
    with pytest.raises(StoreError, match="cannot be read as Parquet"):
        read_about(done / file.path)
    assert "instead of" in damage(done, file)
    outcome, notes = again(done)
    assert (outcome.present, outcome.done) == (3, 1)
    assert any(note.startswith(f"{done / file.path} has {len(kept):,} bytes instead of") for note in notes)
    assert (done / QUARANTINE / file.path).read_bytes() == kept
    check_sound(done, read(whole)[0])
    injected("file cut to 0, 1, half or all but one of its bytes")


@pytest.mark.parametrize("left", LENGTHS)
@pytest.mark.parametrize("name", [MANIFEST, CONFIG])
def test_a_cut_manifest_or_configuration_costs_the_runs_it_named_at_most(done, whole, name, left, injected):
    cut(done / name, left)
    outcome, notes = again(done)
    assert outcome.present + outcome.done == 4
    if name == CONFIG:
        assert outcome.done == 0
    elif left == "n - 1 bytes":
        assert outcome.done == 1
        assert re.search(r"manifest.jsonl, line \d+: is cut off, and ignored", notes[0])
    check_sound(done, read(whole)[0])
    injected("file cut to 0, 1, half or all but one of its bytes")


@pytest.mark.parametrize("left", LENGTHS)
@pytest.mark.parametrize("name", ["state.npz", "part-0.npz"])
def test_a_cut_checkpoint_is_named_and_its_runs_start_anew(tmp_path, whole, name, left, injected):
    config = study(*SMALL, seeds="0..1")
    assert sweep(config, tmp_path, simulate=toy, stop=StopAfter(2)).stopped
    (path,) = tmp_path.glob(f"{CHECKPOINTS}/*/*/{name}")
    cut(path, left)
    _, notes = again(tmp_path)
    assert notes == [f"the checkpoint {path.parent} cannot be read: its runs start anew"]
    check_sound(tmp_path, read(whole)[0])
    injected("file cut to 0, 1, half or all but one of its bytes")


# --- CR-13 ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", [-3600, 3600, -1e9], ids=["an hour ago", "in an hour", "long ago"])
def test_times_of_files_and_of_the_clock_mean_nothing(tmp_path, whole, seconds, monkeypatch, injected):
    calls = []

    def counting(*arguments, **settings):
        calls.append(1)
        return toy(*arguments, **settings)

    config = study(*SMALL, seeds="0..1")
    sweep(config, tmp_path, simulate=counting, stop=StopAfter(6))  # 4 epochs of one group, 1 of the other
    now = time.time()
    paths = list(tmp_path.rglob("*"))
    for path in paths:
        os.utime(path, (now + seconds, now + seconds))

    class Clock(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.datetime.now(tz) - datetime.timedelta(hours=1)

    monkeypatch.setattr(store_module, "datetime", Clock)
    monkeypatch.setattr(time, "time", lambda: now - 3600)
    assert sweep(config, tmp_path, simulate=counting).present == 2
    assert len(calls) == 8  # no epoch twice
    check_sound(tmp_path, read(whole)[0])
    assert sweep(config, tmp_path, simulate=counting).done == 0
    injected("time of a file changed", len(paths))


# --- CR-10 ---------------------------------------------------------------------------------------------------------

CHANGES = {
    "learning.rate": ("learning.rate=0.2", "0.1", "0.2", "in all 2 conditions"),
    "physics.dt": ("physics.dt=0.005", "0.02", "0.005", "in all 2 conditions"),
    "wobble.amplitude": ("conditions.mass.wobble.amplitude=0.2", "0.3", "0.2", "in mass"),
}


@pytest.mark.parametrize("key", CHANGES)
def test_a_changed_value_is_refused_with_key_there_and_here_and_nothing_is_changed(done, key, injected):
    setting, there, here, where = CHANGES[key]
    before = {path: path.read_bytes() for path in done.rglob("*") if path.is_file() and path.name != ".lock"}
    with pytest.raises(StoreError) as refused:
        again(done, setting)
    assert re.search(rf"\n  {re.escape(key)} +{there} +{here} +{where}\n.*--fork", str(refused.value), re.DOTALL)
    after = {path: path.read_bytes() for path in done.rglob("*") if path.is_file() and path.name != ".lock"}
    assert after == before
    injected("changed setting or kernel")


def test_another_kernel_is_refused_with_both_hashes(done, monkeypatch, injected):
    mine = store_module.kernel_hash()
    monkeypatch.setattr(store_module, "kernel_hash", lambda: "0123456789abcdef")
    with pytest.raises(StoreError, match=rf'\n  kernel +"{mine}" +"0123456789abcdef" +in all 2 conditions\n'):
        again(done)
    injected("changed setting or kernel")


def test_the_command_refuses_with_exit_code_2(done, tmp_path, monkeypatch, injected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text((done / CONFIG).read_text())
    found = CliRunner().invoke(main, ["sweep", "study.yaml", "--out", str(done), "--set", "learning.rate=0.2"])
    assert (found.exit_code, found.stdout) == (2, "")
    assert "learning.rate" in found.stderr
    assert "Traceback" not in found.stderr
    injected("changed setting or kernel")


def test_a_fork_takes_over_what_is_unchanged_bit_for_bit_and_computes_the_rest(done, whole, tmp_path, injected):
    fork, change = tmp_path / "fork", "conditions.mass.wobble.amplitude=0.2"
    config = study(*SMALL, change, seeds="0..1")
    computed = []

    def counting(*arguments, **settings):
        computed.append(1)
        return toy(*arguments, **settings)

    stopped = sweep(config, fork, simulate=counting, fork_of=done, stop=StopAfter(2))
    assert (stopped.present, stopped.done, stopped.stopped) == (2, 0, True)
    assert sweep(config, fork, simulate=counting, fork_of=done).done == 2  # the same call goes on
    assert len(computed) == 4
    sweep(config, tmp_path / "fresh", simulate=toy)
    check_sound(fork, read(tmp_path / "fresh")[0])
    for path, file in read_manifest(fork).every_file().items():
        if "condition=fixed" in path:
            assert file == read_manifest(done).every_file()[path]
            assert (fork / path).samefile(done / path)
    check_sound(done, read(whole)[0])
    injected("changed setting or kernel")
