"""The pages on clusters do what they say: their own code is run, on this machine, with a stand-in for SLURM."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from study.test_cluster import within
from study.test_cluster_security import free_port
from study.toy import content

from wobblesim.physics.kernels import cache_folder
from wobblesim.study.execute import sweep
from wobblesim.study.manifest import read_manifest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "how-to"

STUDY = """
name: study
seeds: 0..3
trial: {duration: 2}
learning: {epochs: %d}
wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 10}
conditions: {fixed: {wobble: null}, wobbling: {}}
"""

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(not (shutil.which("openssl") and shutil.which("bash")), reason="needs openssl and bash"),
]


def blocks(page, language):
    """The code of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", (PAGES / page).read_text(), re.MULTILINE | re.DOTALL)


def block(page, language, mark):
    """The one that has a mark."""
    (found,) = [code for code in blocks(page, language) if mark in code]
    return found


def changed(code, words):
    """Code with other words; each must be there."""
    for word, other in words.items():
        assert word in code
        code = code.replace(word, other)
    return code


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder, our commands and a SLURM of our own."""
    state, programs = tmp_path / "slurm", tmp_path / "programs"
    state.mkdir()
    programs.mkdir()
    for name in ("sbatch", "scancel", "scontrol"):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec {sys.executable} {ROOT}/tests/study/fake_slurm.py {name} "$@"\n')
        program.chmod(0o755)
    paths = [str(programs), str(Path(sys.executable).parent), os.environ["PATH"]]
    monkeypatch.setenv("PATH", os.pathsep.join(paths))
    monkeypatch.setenv("FAKE_SLURM", str(state))
    monkeypatch.setenv("SLURM_TMPDIR", str(tmp_path / "node"))
    share_kernels(tmp_path / "node")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for job in state.glob("*.pid"):
        with suppress(ProcessLookupError):
            os.killpg(os.getpgid(int(job.read_text())), signal.SIGKILL)


def share_kernels(node):
    """Let a node have the kernels that this machine has compiled already, where NUMBA_CACHE_DIR would have them."""
    node.mkdir()
    mine = cache_folder()
    (node / f"wobblesim-{os.geteuid()}-{mine.name}").symlink_to(mine)


def shell(code):
    return subprocess.run(["bash", "-euc", code], check=True, capture_output=True, text=True)


def expect_rows_of_one_process(place):
    sweep(place / "study.yaml", place / "alone")
    assert len(read_manifest(place / "alone").runs) == 8
    assert content(place / "results/study") == content(place / "alone")


def test_the_job_array_goes_on_after_its_time_is_up(place):
    (place / "study.yaml").write_text(STUDY % 1500)
    script = block("slurm.md", "bash", "--array")
    smaller = {"--array=1-8": "--array=1-2", "--cpus-per-task=16": "--cpus-per-task=1"}
    (place / "array.sh").write_text(changed(script, smaller))
    shell("sbatch array.sh")
    first = place / "slurm" / "101.pid"
    lock = place / "results/study/.lock-1-of-2"
    assert within(60, lock.exists)
    time.sleep(2)
    os.kill(int(first.read_text()), signal.SIGTERM)  # --signal=B:TERM: the shell alone
    codes = [place / "slurm" / f"{job}.codes" for job in (101, 102)]
    assert within(120, lambda: [path.exists() and path.read_text().split()[-1] for path in codes] == ["0", "0"])
    assert codes[0].read_text().split() == ["4", "0"]
    shell(block("slurm.md", "shell", "wobblesim status"))
    expect_rows_of_one_process(place)


def test_worker_jobs_compute_a_study_with_certificates(place):
    pytest.importorskip("dask_jobqueue")
    (place / "study.yaml").write_text(STUDY % 30)
    shell(block("cluster.md", "shell", "openssl"))
    smaller = {"ib0": "lo", "cores=16": "cores=1", "=8, max": "=2, max", "jobs=8)": "jobs=2)", '="/tmp"': '="node"',
               "NUMBA_CACHE_DIR=/tmp": "NUMBA_CACHE_DIR=$SLURM_TMPDIR", "THREADS=16": "THREADS=1"}  # fmt: skip
    (place / "workers.py").write_text(changed(block("slurm.md", "python", "SLURMCluster"), smaller))
    done = subprocess.run([sys.executable, "workers.py"], check=False, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr
    assert "done=8, failed=0, stopped=False" in done.stdout
    scripts = [path.read_text() for path in (place / "slurm").glob("*.sh")]
    assert len(scripts) >= 2
    assert all("#SBATCH -t 04:00:00" in script and "--tls-ca-file" in script for script in scripts)
    expect_rows_of_one_process(place)


def test_a_scheduler_a_worker_and_a_sweep_started_by_hand(place):
    (place / "study.yaml").write_text(STUDY % 30)
    shell(block("cluster.md", "shell", "openssl"))
    here = {"HOST:8786": f"127.0.0.1:{free_port()}", "--nthreads 16": "--nthreads 1"}
    with (
        started(
            changed(block("cluster.md", "shell", "dask scheduler"), {"--port 8786": f"--host {here['HOST:8786']}"})
        ),
        started(changed(block("cluster.md", "shell", "dask worker"), here)),
    ):
        sweep_command = block("cluster.md", "shell", "--scheduler tls")
        shell(changed(sweep_command, {"HOST:8786": here["HOST:8786"]}))
    expect_rows_of_one_process(place)


@contextmanager
def started(code):
    with subprocess.Popen(["bash", "-euc", code], stderr=subprocess.DEVNULL, start_new_session=True) as process:
        yield
        os.killpg(process.pid, signal.SIGKILL)


def test_the_script_on_workers_here(place):
    (place / "study.yaml").write_text(STUDY % 30)
    (place / "run.py").write_text(block("cluster.md", "python", "cluster(workers=2)"))
    subprocess.run([sys.executable, "run.py"], check=True, timeout=180)
    expect_rows_of_one_process(place)
