"""What docs/security.md promises. SE-3, SE-6, SE-7, SE-9; the others stand with what they are about."""

import ast
import ctypes
import getpass
import json
import os
import pickle
import re
import socket
import sys
import tomllib
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from packaging.requirements import Requirement
from packaging.version import Version
from study.toy import StopAfter, study, toy

from wobblesim.analysis.tables import load
from wobblesim.commands import main
from wobblesim.physics import kernels
from wobblesim.study import resume
from wobblesim.study.execute import sweep
from wobblesim.study.rerun import read_run
from wobblesim.study.work import Interval

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [ROOT / "cli.py", *sorted((ROOT / "wobblesim").rglob("*.py"))]

# --- no pickle of files that users can write to (SE-3) -------------------------------------------------------------

UNPICKLERS = {"pickle", "cPickle", "_pickle", "dill", "joblib", "cloudpickle", "shelve", "marshal", "jsonpickle"}
READERS = {"read_pickle", "to_pickle"}  # of pandas
OWN_KERNELS = "wobblesim/physics/kernels.py"  # the user's own files in a folder of the user's own, see below


def findings(source: str) -> set[str]:
    """What in a source could run code that a file holds."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names if name.name.partition(".")[0] in UNPICKLERS}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in UNPICKLERS:
            found.add(str(node.module))
        elif isinstance(node, ast.Attribute) and node.attr in READERS:
            found.add(node.attr)
        elif isinstance(node, ast.Call):
            found |= findings_of_call(node)
    return found


def findings_of_call(call: ast.Call) -> set[str]:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    allow = {word.arg: word.value for word in call.keywords}.get("allow_pickle")
    if allow is not None and not (isinstance(allow, ast.Constant) and allow.value is False):
        return {"allow_pickle"}
    of_numpy = isinstance(call.func, ast.Attribute) and getattr(call.func.value, "id", "") in ("np", "numpy")
    return {"np.load"} if of_numpy and name == "load" and allow is None else set()


BAIT = {
    "import pickle": "pickle", "from joblib import load": "joblib", "import cloudpickle.fast": "cloudpickle.fast",
    "pd.read_pickle(path)": "read_pickle", "np.load(path)": "np.load", "numpy.load(path)": "np.load",
    "np.load(path, allow_pickle=True)": "allow_pickle", "np.save(path, x, allow_pickle=sure)": "allow_pickle",
    "f(allow_pickle=1)": "allow_pickle",
}  # fmt: skip


@pytest.mark.parametrize("source", BAIT)
def test_the_scan_finds_what_it_looks_for(source):
    assert findings(source) == {BAIT[source]}
    assert findings("np.load(path, allow_pickle=False); json.load(file); np.savez(path, x)") == set()


def test_no_source_can_run_what_a_file_holds_but_that_of_the_kernel_cache():
    found = {path.relative_to(ROOT).as_posix(): what for path in SOURCES if (what := findings(path.read_text("utf-8")))}
    assert found == {OWN_KERNELS: {"pickle"}}


def test_the_linter_looks_for_the_rest_and_what_it_is_told_to_overlook_is_known():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["ruff"]["lint"]
    assert "S" in settings["select"]  # bandit's rules: eval, exec, shells, unsafe YAML, weak hashes, temporary files
    assert {rule for rule in settings["ignore"] if re.fullmatch(r"S\d*", rule)} == {"S101"}
    assert not [path for path in settings["per-file-ignores"] if path.startswith("wobblesim/") and "S" in path]
    overlooked = {
        (path.relative_to(ROOT).as_posix(), rule)
        for path in SOURCES
        for comment in re.findall(r"# noqa: ([A-Z0-9, ]+)", path.read_text(encoding="utf-8"))
        for rule in re.findall(r"S\d+", comment)
    }
    programs = {("wobblesim/study/provenance.py", "S603"), ("wobblesim/viewing/animation.py", "S603")}  # git, ffmpeg
    assert overlooked == {(OWN_KERNELS, "S301")} | programs


# --- planted files are not opened ----------------------------------------------------------------------------------


class Bomb:
    """Makes a marker when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def plant(folder: Path, marker: Path) -> set[str]:
    """Put files that explode when they are unpickled into every folder of the results; return their names."""
    content = {
        ".pkl": pickle.dumps(Bomb(marker)),
        ".pickle": pickle.dumps(Bomb(marker)),
        ".joblib": pickle.dumps(Bomb(marker)),
        ".nbc": kernels.hashlib.sha256(pickle.dumps(Bomb(marker))).digest() + pickle.dumps(Bomb(marker)),
    }
    np.save(folder / "x.npy", np.array([Bomb(marker)]), allow_pickle=True)
    content[".npy"] = (folder / "x.npy").read_bytes()
    (folder / "x.npy").unlink()
    names = set()
    for place in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
        for name in ("planted", "seed-0.parquet", "state.npz", "part-0.npz", "manifest.jsonl", "config.yaml"):
            for suffix, data in content.items():
                (place / f"{name}{suffix}").write_bytes(data)
                names.add(f"{name}{suffix}")
    return names


IN_OPEN, IN_NONBLOCK = 0x20, 0o4000


@contextmanager
def opened_files(folder: Path):
    """Names of the files below a folder that anything opens meanwhile, pyarrow's C++ included (Linux: inotify)."""
    libc, names = ctypes.CDLL(None, use_errno=True), set()
    queue = libc.inotify_init1(IN_NONBLOCK)
    for place in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
        assert libc.inotify_add_watch(queue, os.fsencode(place), IN_OPEN) >= 0

    def read() -> None:
        while True:
            try:
                events = os.read(queue, 1 << 20)
            except BlockingIOError:
                return
            while events:
                size = int.from_bytes(events[12:16], sys.byteorder)
                names.add(events[16 : 16 + size].rstrip(b"\0").decode())
                events = events[16 + size :]

    try:
        yield names
        read()
    finally:
        os.close(queue)


def use(folder: Path) -> None:
    """All that reads results: status, analysis, repetition, and the sweep that goes on with them."""
    assert CliRunner().invoke(main, ["status", str(folder)]).exit_code == 0
    results = load(folder)
    for table in (results.runs, results.epochs, results.trials, results.behaviours):
        table()
    for path in folder.glob("*/condition=*/seed-*.parquet"):
        read_run(path)
    assert resume.standing(folder, "fixed")
    assert sweep(study(seeds="0..3"), folder, simulate=toy).done == 4


@pytest.fixture
def planted(tmp_path):
    """A folder of results half done, the names of pickles planted in it, and the marker that they make."""
    folder, marker = tmp_path / "results", tmp_path / "marker"
    sweep(study(seeds="0..1"), folder, simulate=toy)
    sweep(study(seeds="0..3"), folder, simulate=toy, stop=StopAfter(7))
    names = plant(folder, marker)
    yield folder, names, marker
    assert not marker.exists()
    pickle.loads((folder / "planted.pkl").read_bytes())
    assert marker.exists()  # the bombs are live ones


@pytest.mark.skipif(sys.platform != "linux", reason="needs inotify")
def test_pickles_planted_in_a_folder_of_results_are_not_opened(planted):
    folder, planted_names, _ = planted
    with opened_files(folder) as names:
        use(folder)
    assert {"manifest.jsonl", "seed-0.parquet", "state.npz"} <= names  # what is looked for is seen
    assert names & planted_names == set()


def test_pickles_planted_in_a_folder_of_results_are_foreign_files_to_verify(planted):
    # It reads what lies in the datasets, as bytes and as Parquet, to say what it is.
    found = CliRunner().invoke(main, ["verify", str(planted[0])])
    assert found.exit_code == 3
    assert "seed-0.parquet.pkl: is foreign: no sweep has written it" in found.stdout


def test_a_checkpoint_that_holds_a_pickle_is_not_loaded(tmp_path):
    folder, marker = tmp_path / "results", tmp_path / "marker"
    sweep(study(), folder, simulate=toy, stop=StopAfter(7))
    (state,) = folder.glob("checkpoints/*/*/state.npz")
    with np.load(state) as archive:
        arrays = dict(archive)
    with state.open("wb") as file:
        np.savez(file, **arrays | {"identity": np.array([Bomb(marker)])})
    assert resume.standing(folder, "fixed") == []
    assert sweep(study(), folder, simulate=toy).done == 8
    assert not marker.exists()


# --- versions with known holes (SE-6) ------------------------------------------------------------------------------

FLOORS = {
    "pyarrow": "14.0.1",  # CVE-2023-47248: code from Parquet and IPC files
    "distributed": "2021.10.0",  # CVE-2021-42343: workers open to the network
    "PyYAML": "5.4",  # CVE-2020-14343
    "cryptography": "42.0.4",  # CVE-2024-26130
}


def requirements() -> dict[str, Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [line for lines in project["optional-dependencies"].values() for line in lines]
    return {found.name: found for found in map(Requirement, project["dependencies"] + extras)}


def pins() -> dict[str, Version]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {name.lower().replace("_", "-"): Version(version) for name, version in pairs}


@pytest.mark.parametrize("name", FLOORS)
def test_no_version_with_a_known_hole_is_allowed(name):
    (floor,) = requirements()[name].specifier
    assert floor.operator == ">="
    assert Version(floor.version) >= Version(FLOORS[name])
    assert Version(metadata.version(name)) >= Version(FLOORS[name])


def test_every_pin_is_one_that_its_requirement_allows():
    pinned = pins()
    wrong = [str(needed) for name, needed in requirements().items() if pinned[name.lower()] not in needed.specifier]
    assert not wrong


# --- the cache of kernels (SE-7) -----------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A folder of kernels of one's own, with a kernel that explodes."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(kernels, "FOLDER", kernels._usable_folder())
    assert twice() == 4.0
    (path,) = kernels.cache_folder().rglob("*.nbc")
    bomb = pickle.dumps(Bomb(tmp_path / "marker"))
    path.write_bytes(kernels.hashlib.sha256(bomb).digest() + bomb)
    return path


def twice() -> float:
    """What a kernel says that is looked for in the cache."""
    kernels.FOLDER = kernels._usable_folder()

    @kernels.kernel
    def twice(x):
        return x + x

    return twice(2.0)


def test_the_kernels_of_a_folder_of_ones_own_are_loaded(cache, tmp_path):
    with pytest.raises(TypeError):  # the marker is no kernel
        twice()
    assert (tmp_path / "marker").exists()


@pytest.mark.parametrize("mode", [0o770, 0o777, 0o722])
def test_the_kernels_of_a_folder_that_others_can_write_to_are_not_loaded(cache, tmp_path, mode):
    kernels.cache_folder().chmod(mode)
    kernels._warn.cache_clear()
    with pytest.warns(RuntimeWarning, match="others may write"):
        assert twice() == 4.0
    assert not (tmp_path / "marker").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
@pytest.mark.parametrize("what", ["folder", "file"])
def test_the_kernels_of_another_user_are_not_loaded(cache, tmp_path, what):
    try:
        os.chown(cache if what == "file" else kernels.cache_folder(), 65534, 65534)
    except OSError:
        pytest.skip("there is no other user in this namespace")
    kernels._warn.cache_clear()
    if what == "folder":
        with pytest.warns(RuntimeWarning, match="others may write"):
            assert twice() == 4.0
    else:
        assert twice() == 4.0
    assert not (tmp_path / "marker").exists()


# --- nothing of who, where or what else (SE-9) ---------------------------------------------------------------------

STUDY = """
name: leak
seeds: 0..1
robot: {kind: starfish, arms: 3, sections: 2}
trial: {duration: 1}
learning: {epochs: 3}
log: behaviours
"""


@pytest.fixture
def secrets(tmp_path, monkeypatch):
    """What must not stand in a folder of results, by what it is."""
    home = tmp_path / "home-of-somebody"
    home.mkdir()
    for name, value in {"HOME": str(home), "USER": "somebody-7f3a", "LOGNAME": "somebody-7f3a"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("TOKEN", "c0ffee-in-the-environment")
    monkeypatch.setattr(socket, "gethostname", lambda: "host-of-somebody")
    monkeypatch.chdir(home)
    found = {
        "user": getpass.getuser(), "home": "home-of-somebody", "host": "host-of-somebody", "folder": str(tmp_path),
        "environment": "c0ffee-in-the-environment", "package": str(ROOT), "python": sys.prefix,
    }  # fmt: skip
    assert found["user"] == "somebody-7f3a"
    return {name: value.encode() for name, value in found.items()}


def plain(path: Path) -> bytes:
    """The content of a file, unpacked."""
    content = path.read_bytes()
    if path.suffix == ".parquet":
        table = pq.ParquetFile(path).read()
        content += json.dumps(table.to_pylist(), default=str).encode() + str(table.schema.metadata).encode()
        content += str(table.schema).encode()
    elif path.suffix == ".npz":
        with np.load(path) as archive:
            content += b"".join(str(array).encode() for array in archive.values())
    return content


def leaks(folder: Path, secrets: dict[str, bytes]) -> list[tuple[str, str]]:
    """Which file, by name or by content, holds which secret."""
    found = []
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        content = name.encode() + (plain(path) if path.is_file() else b"")
        found += [(name, what) for what, secret in secrets.items() if secret in content]
    return found


IN_THE_LOCK = [(".lock", "host")]  # beside the number of the process: who asks has to know whom to ask


def test_no_file_of_a_sweep_tells_of_the_user_the_machine_or_the_environment(secrets):
    Path("leak.yaml").write_text(STUDY)
    found = CliRunner().invoke(main, ["sweep", "leak.yaml"])
    assert found.exit_code == 0, found.output
    folder = Path("results/leak")
    assert {path.suffix for path in folder.rglob("*") if path.is_file()} >= {".parquet", ".jsonl", ".yaml", ".png"}
    assert leaks(folder, secrets) in ([], IN_THE_LOCK)
    (folder / ".lock").unlink()
    (folder / "planted").write_text(os.environ["TOKEN"])
    assert leaks(folder, secrets) == [("planted", "environment")]  # what is looked for is found


def test_a_stopped_sweep_tells_nothing_either(secrets):
    sweep(study(), "stopped", simulate=toy, stop=StopAfter(7))
    assert list(Path("stopped").rglob("state.npz"))
    assert leaks(Path("stopped"), secrets) in ([], IN_THE_LOCK)


def test_a_failed_run_tells_what_went_wrong_and_not_where(secrets):
    def fails(*_, **__):
        raise FloatingPointError("too light")

    assert sweep(study(), "failed", simulate=fails).failed == 8
    assert "too light" in Path("failed/manifest.jsonl").read_text()
    assert leaks(Path("failed"), secrets) in ([], IN_THE_LOCK)


def test_nothing_but_the_lock_names_the_machine_while_a_sweep_is_at_work(secrets):
    seen = []

    def look(*arguments, **settings):
        seen.append(leaks(Path("held"), secrets))
        return toy(*arguments, **settings)

    sweep(study(), "held", simulate=look, checkpoint=Interval(epochs=1))
    assert len(seen) == 24
    assert all(found == IN_THE_LOCK for found in seen)


@pytest.mark.parametrize(
    ("event", "arguments"),
    [
        ("socket.connect", (("192.0.2.1", 80),)),
        ("socket.connect", (("2001:db8::1", 80, 0, 0),)),
        ("socket.connect", (("example.org", 80),)),
        ("socket.sendto", (("192.0.2.1", 53),)),
    ],
)
def test_the_tests_reach_no_other_machine(event, arguments):
    with socket.socket() as tried, pytest.raises(OSError, match="not on loopback"):
        sys.audit(event, tried, *arguments)  # what a socket says before it does it
    with pytest.raises(socket.gaierror, match="not on loopback"):
        sys.audit("socket.getaddrinfo", "example.org", 80, 0, 0, 0)


def test_the_tests_reach_this_machine():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as mine:
        assert mine.getpeername() == server.getsockname()
    assert socket.getaddrinfo("localhost", 80)
