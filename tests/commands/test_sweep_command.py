"""`wobblesim sweep`, `status` and `check` as a user meets them, on a robot of three nodes."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest
from click.testing import CliRunner

from wobblesim.analysis.tables import load
from wobblesim.commands import main
from wobblesim.commands.display import Plain, duration
from wobblesim.study.manifest import read_manifest

ROOT = Path(__file__).parents[2]

STUDY = """
name: three
seeds: 0..1
robot:
  kind: custom
  nodes: [{position: [0, 0]}, {position: [40, 0]}, {position: [20, 30]}]
  springs:
    - {between: [0, 1], stiffness: 3000}
    - {between: [1, 2], stiffness: 3000}
    - {between: [2, 0], stiffness: 3000}
  muscles: [{spring: 0, group: 0}, {spring: 1, group: 1}]
trial: {duration: 0.5}
learning: {epochs: 6}
conditions:
  fixed: {wobble: null}
  mass: {wobble: {dimension: mass, amplitude: 0.3, period: 5, end: 3}}
"""


@pytest.fixture(autouse=True)
def config(tmp_path, monkeypatch):
    """Work in an empty folder with a configuration."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "three.yaml"
    path.write_text(STUDY)
    return path


def call(*arguments: str):
    return CliRunner().invoke(main, list(arguments))


@contextmanager
def started(*arguments: str) -> Iterator[subprocess.Popen]:
    """The command in a process of its own, which does not outlive the test."""
    command = [sys.executable, str(ROOT / "cli.py"), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_sweep_ends_with_a_summary_on_stdout_and_two_paths(tmp_path):
    found = call("sweep", "three.yaml")
    assert found.exit_code == 0, found.stderr
    lines = found.stdout.splitlines()
    assert lines[-2:] == ["results: results/three", "picture: results/three/figures/learning-curve.png"]
    (fixed,), (mass,) = ([line for line in lines if line.split()[:1] == [name]] for name in ("fixed", "mass"))
    assert "–" in fixed
    assert mass.count("±") == 4
    assert Path("results/three/figures/learning-curve.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_terminal_there_are_plain_lines_on_stderr_and_no_escape_codes():
    found = call("sweep", "three.yaml")
    assert "\x1b" not in found.output
    assert "\r" not in found.output
    runs = [line for line in found.stderr.splitlines() if "body lengths (" in line]
    assert [line.partition(":")[0] for line in runs] == [
        "fixed, seed 0",
        "fixed, seed 1",
        "mass, seed 0",
        "mass, seed 1",
    ]
    assert "4 of 4 runs done, 0 failed, 0 trials diverged" in runs[-1]


def test_the_first_line_says_that_kernels_are_compiled_if_they_are(monkeypatch):
    monkeypatch.setattr("wobblesim.physics.kernels.is_warm", lambda: False)
    assert call("sweep", "three.yaml").stderr.startswith("compiling kernels, once on this machine")


def test_the_bars_are_drawn_when_asked_for():
    found = call("sweep", "three.yaml", "--progress", "rich")
    assert found.exit_code == 0
    assert "4 of 4 runs done" in found.stderr


def test_json_is_all_there_is_on_stdout():
    found = call("sweep", "three.yaml", "--json", "--progress", "none")
    data = json.loads(found.stdout)
    assert (data["wanted"], data["done"], data["failed"], data["stopped"]) == (4, 4, 0, False)
    assert [row["condition"] for row in data["conditions"]] == ["fixed", "mass"]
    assert data["conditions"][0]["difference"] is None
    assert data["conditions"][1]["pairs"] == 2


def test_the_same_command_again_does_nothing_and_says_the_same():
    first, second = call("sweep", "three.yaml"), call("sweep", "three.yaml")
    assert second.stdout == first.stdout
    assert "4 of 4 runs done before" in second.stderr


def test_options_override_the_file():
    call(
        "sweep", "three.yaml", "--seeds", "3", "--set", "learning.epochs=2", "--set", "log=trials", "--out", "elsewhere"
    )
    assert set(read_manifest(Path("elsewhere")).runs) == {("fixed", 3), ("mass", 3)}
    assert Path("elsewhere/trials").is_dir()


def test_a_dry_run_counts_and_writes_nothing(tmp_path):
    found = call("sweep", "three.yaml", "--dry-run", "--json")
    data = json.loads(found.stdout)
    # 25 steps; 20 behaviours while the morphology may change (epoch 0; epochs 0 to 3), 15 after that.
    fixed, mass = 2 * 25 * (20 + 5 * 15), 2 * 25 * (4 * 20 + 2 * 15)
    assert [row["lane_steps"] for row in data["conditions"]] == [fixed, mass]
    assert (data["missing"], data["lane_steps"]) == (4, fixed + mass)
    assert [path.name for path in tmp_path.iterdir()] == ["three.yaml"]


def test_a_dry_run_knows_what_is_there():
    call("sweep", "three.yaml", "--seeds", "1")
    found = call("sweep", "three.yaml", "-n")
    assert re.search(r"all +4 +2 +2 ", found.stdout)


# --- refusals: exit code 2, one sentence, nothing computed ---------------------------------------------------------


def test_a_bad_configuration_is_one_line_with_its_place(config):
    config.write_text(STUDY.replace("duration: 0.5", "durration: 0.5"))
    for command in ("sweep", "check"):
        found = call(command, "three.yaml")
        assert found.exit_code == 2
        assert found.stderr == "three.yaml:12:9: trial.durration: unknown key (did you mean 'duration'?)\n"
        assert found.stdout == ""


def test_an_impossible_step_is_refused_before_the_folder_is_made():
    found = call("sweep", "three.yaml", "--set", "physics.integrator=explicit", "--set", "physics.dt=0.5")
    assert found.exit_code == 2
    assert found.stderr.startswith("--set physics.dt=0.5: physics.dt: explicit is unstable at dt 0.5 s")
    assert found.stderr.count("\n") == 1
    assert not Path("results").exists()


def test_an_unwritable_folder_is_refused_in_one_line():
    Path("file").write_text("in the way")
    found = call("sweep", "three.yaml", "--out", "file/deeper")
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr == "cannot write to file/deeper: not a directory; choose another folder with --out\n"


def test_changed_settings_in_the_same_folder_are_refused_with_their_keys():
    call("sweep", "three.yaml")
    for dry in ([], ["--dry-run"]):
        found = call("sweep", "three.yaml", "--set", "physics.dt=0.005", *dry)
        assert found.exit_code == 2
        assert found.stderr.splitlines() == [
            "results/three holds results of other settings or of another simulator:",
            "  setting     there  here",
            "  physics.dt  0.02   0.005  in all 2 conditions",
            "Undo the change, or give --fork DIR to start a folder beside it that takes over what is unchanged.",
        ]


def test_a_fork_takes_over_what_is_unchanged_and_computes_the_rest():
    call("sweep", "three.yaml")
    fork = ("sweep", "three.yaml", "--set", "conditions.mass.learning.rate=0.2", "--fork", "results/second", "--json")
    found = call(*fork)
    told = json.loads(found.stdout)
    assert (found.exit_code, told["results"], told["present"], told["done"]) == (0, "results/second", 2, 2)
    assert "2 of 4 runs taken over from results/three" in found.stderr
    first, second = (read_manifest(Path("results", name)) for name in ("three", "second"))
    assert first.runs["fixed", 0].files == second.runs["fixed", 0].files
    assert first.runs["mass", 0].files != second.runs["mass", 0].files
    assert json.loads(call(*fork).stdout)["present"] == 4


def test_shards_share_a_folder_and_together_make_the_study():
    for k in (1, 2, 3):
        found = call("sweep", "three.yaml", "--out", "parts", "--shard", f"{k}/3")
        assert found.exit_code == 0
        assert re.search(rf"shard {k}/3: (\d) of \1 runs? done", found.stdout)
    call("sweep", "three.yaml")
    assert json.loads(call("sweep", "three.yaml", "--out", "parts", "--json").stdout)["done"] == 0
    parts, whole = (load(folder).epochs() for folder in ("parts", "results/three"))
    pd.testing.assert_frame_equal(parts, whole)


@pytest.mark.parametrize("shard", ["0/3", "4/3", "2", "a/b", "1/0"])
def test_a_shard_that_cannot_be_is_refused(shard):
    found = call("sweep", "three.yaml", "--shard", shard)
    assert (found.exit_code, "Invalid value for --shard" in found.stderr) == (2, True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--workers", "2"], "--workers needs --engine dask"),
        (["--engine", "dask", "--tls-ca", "three.yaml"], "belong together"),
        (["--engine", "dask", "--insecure-tcp"], "are for a --scheduler"),
        (["--engine", "dask", "--scheduler", "somewhere"], "is not the address of a scheduler"),
        (["--engine", "dask", "--scheduler", "tcp://10.0.0.1:8786"], "is not encrypted"),
        (["--engine", "dask", "--scheduler", "tls://127.0.0.1:8786"], "tls:// needs certificates"),
    ],
)
def test_engine_options_that_mean_nothing_together_are_refused(options, said):
    found = call("sweep", "three.yaml", *options)
    assert (found.exit_code, said in found.stderr) == (2, True)


@pytest.mark.parametrize("command", ["status", "plot"])
def test_a_folder_without_results_is_refused(command):
    found = call(command, "nowhere")
    assert (found.exit_code, found.stderr.count("\n")) == (2, 1)
    assert "nowhere holds no results" in found.stderr


# --- failures and stops --------------------------------------------------------------------------------------------


def test_failed_runs_are_exit_code_3_and_rows_without_a_score():
    found = call("sweep", "three.yaml", "--set", "physics.max_speed=0.001")
    assert found.exit_code == 3
    assert "fixed, seed 0: failed, all trials of the last epoch diverged" in found.stderr
    assert found.stderr.endswith("4 runs failed: see `wobblesim status results/three`\n")
    assert "2 (2 excluded)" in found.stdout
    assert "nan" not in found.stdout
    rows = json.loads(call("status", "results/three", "--json").stdout)["conditions"]
    assert [(row["done"], row["failed"], row["diverged"]) for row in rows] == [(2, 2, 240), (2, 2, 240)]


def test_an_error_of_ours_has_a_traceback_and_is_exit_code_1(monkeypatch):
    monkeypatch.setattr("wobblesim.study.execute.dump", lambda _: 1 / 0)
    found = call("sweep", "three.yaml")
    assert found.exit_code == 1
    assert isinstance(found.exception, ZeroDivisionError)


LONG = ("sweep", "three.yaml", "--set", "learning.epochs=100000", "--set", "trial.duration=2")


def wait_until_it_computes(process: subprocess.Popen) -> None:
    while "runs done" not in process.stderr.readline():
        assert process.poll() is None
    time.sleep(0.3)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_sweep_in_order_and_the_told_command_goes_on(number):
    with started(*LONG) as process:
        wait_until_it_computes(process)
        process.send_signal(number)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 4
    assert said.startswith("stopping after this epoch")
    told = said.splitlines()[-1].removeprefix("stopped; to go on: ")
    assert shlex.split(told) == ["python", "cli.py", *LONG]
    status = json.loads(call("status", "results/three", "--json").stdout)
    assert status["writers"] == []
    assert re.fullmatch(r"fixed, seeds 0..1: epoch \d+", status["conditions"][0]["in_progress"])


def test_a_second_ctrl_c_leaves_at_once():
    # One epoch of this takes far longer than the test.
    with started(*LONG, "--set", "trial.duration=86400", "--set", "physics.dt=0.001") as process:
        wait_until_it_computes(process)
        process.send_signal(signal.SIGINT)
        assert process.stderr.readline().startswith("stopping after this epoch")
        begun = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
        assert time.monotonic() - begun < 1.0  # measured 0.01 s


def test_status_names_the_process_that_is_writing():
    with started(*LONG) as process:
        wait_until_it_computes(process)
        told = json.loads(call("status", "results/three", "--json").stdout)
        second = call("sweep", "three.yaml")
    assert f"process {process.pid} on " in told["writers"][0]
    assert (second.exit_code, f"in use by process {process.pid} on " in second.stderr) == (2, True)


# --- the other commands --------------------------------------------------------------------------------------------


def test_check_counts_what_a_configuration_asks_for():
    found = call("check", "three.yaml")
    assert (found.exit_code, found.stderr) == (0, "")
    assert found.stdout.startswith("three.yaml: sound; 2 conditions, 2 seeds, 4 runs")
    assert json.loads(call("check", "three.yaml", "--json").stdout)["conditions"] == ["fixed", "mass"]


def test_status_counts_wanted_done_and_missing():
    call("sweep", "three.yaml", "--seeds", "0..2")
    found = call("status", "results/three")
    assert found.exit_code == 0
    assert re.search(r"fixed +3 +3 +0 +0 +0 +0\n", found.stdout)
    assert found.stdout.endswith("nobody is writing\n")


def test_a_picture_that_cannot_be_written_is_told_in_one_line_and_the_results_are_safe():
    Path("results/three").mkdir(parents=True)
    Path("results/three/figures").write_text("in the way")
    found = call("sweep", "three.yaml")
    assert found.exit_code == 1
    last = found.stderr.splitlines()[-1]
    assert re.fullmatch(r"the results are safe, their picture is not: cannot write results/three/figures: .*", last)
    assert len(read_manifest(Path("results/three")).runs) == 4


def test_plain_lines_come_at_least_as_often_as_promised(capsys):
    from wobblesim.study.progress import Meter

    with Plain(every=0.05) as shown:
        meter = Meter(shown, wanted=4, present=1, failed=0, work=100)
        meter.group, meter.epoch, meter.epochs = "fixed, seeds 0..3", 7, 50
        meter.tell("epoch")
        time.sleep(0.3)
    said = capsys.readouterr().err.splitlines()
    assert len(said) >= 3
    assert set(said) == {"fixed, seeds 0..3, epoch 7 of 50: 1 of 4 runs done, 0 failed, 0 trials diverged, 0 refined"}


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.4, "0 s"), (59, "59 s"), (150, "2 min"), (5400, "1.5 h"), (2.6e5, "3.0 days")]
)
def test_a_time_is_said_in_the_unit_that_fits(seconds, said):
    assert duration(seconds) == said


def test_a_wobble_beyond_the_safe_region_is_told_with_the_step_that_would_do():
    found = call("sweep", "three.yaml", "--set", "physics.integrator=impulse", "--dry-run")
    assert found.exit_code == 0
    assert re.search(r"warning: mass: mass goes from .* impulse at dt 0\.02 is stable .* would be", found.stderr)
    assert "(measured with another robot" in found.stderr
    assert "warning" not in call("sweep", "three.yaml", "--dry-run").stderr
