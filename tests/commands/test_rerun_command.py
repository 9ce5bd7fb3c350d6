"""`wobblesim rerun`: exit 0 the same bits, 3 other bits, 2 a bad file, 130 Ctrl-C."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from study.toy import study

from wobblesim.commands.rerun import command
from wobblesim.study.execute import sweep
from wobblesim.study.provenance import provenance

ROOT = Path(__file__).parents[2]
ROBOT = ("learning.epochs=3", "trial.duration=1", "conditions.mass.wobble.end=2")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two conditions of a small robot, one seed each."""
    folder = tmp_path_factory.mktemp("robots")
    sweep(study(*ROBOT, seeds="0"), folder)
    return folder


@pytest.fixture
def altered(results, tmp_path):
    """A copy of a table of trials with a score of 1000 in epoch 2, slot 7, and another kernel's hash."""
    table = pq.ParquetFile(file_of(results, "trials")).read()
    scores = table["performance"].to_pylist()
    scores[47] = 1000.0
    place = table.column_names.index("performance")
    about = table.schema.metadata | {b"wobblesim.kernel": b"[bold]another"}
    table = table.set_column(place, "performance", pa.array(scores)).replace_schema_metadata(about)
    pq.write_table(table, tmp_path / "altered.parquet")
    return tmp_path / "altered.parquet"


def file_of(folder, table):
    return folder / table / "condition=mass" / "seed-0.parquet"


def call(*arguments):
    return CliRunner().invoke(command, [str(argument) for argument in arguments], prog_name="wobblesim rerun")


def test_the_same_bits_are_exit_code_0_and_two_lines(results):
    found = call(file_of(results, "epochs"), "--threads", 1)
    assert found.exit_code == 0
    assert found.stdout == "mass, seed 0: 3 epochs repeated, 3 rows of 16 columns of epochs compared\nthe bits agree\n"
    assert "0 of 1 run done" in found.stderr


def test_other_bits_are_exit_code_3_and_two_tables(altered):
    found = call(altered)
    assert found.exit_code == 3
    assert "the bits do not agree: in 1 column, from epoch 2, slot 7 on\n" in found.stdout
    score = r"performance +1 of 60 +epoch 2, slot 7 +1000\.0 +(\S+) +1e\+03\n"
    assert 0.0 < abs(float(re.search(score, found.stdout)[1])) < 10.0
    assert re.search(rf"kernel +\[bold\]another +{provenance()['kernel']}\n", found.stdout)
    assert call(altered, "--epochs", 2).exit_code == 0


def test_all_of_it_is_there_as_json(altered):
    found = call(altered, "--json")
    assert found.exit_code == 3
    told = json.loads(found.stdout)
    assert (told["agree"], told["table"], told["condition"], told["seed"]) == (False, "trials", "mass", 0)
    assert (told["epochs"], told["rows"], told["columns"]) == (3, 60, 12)
    (difference,) = told["differences"]
    assert (difference["first"], difference["stored"]) == ({"epoch": 2, "slot": 7}, 1000.0)
    assert difference["largest"] == 1000.0 - difference["here"]
    assert told["provenance"]["kernel"] == {"stored": "[bold]another", "here": provenance()["kernel"]}
    assert told["provenance"]["numpy"] == dict.fromkeys(("stored", "here"), provenance()["numpy"])


def test_of_the_features_of_another_processor_those_are_shown_that_differ(results, tmp_path):
    table = pq.ParquetFile(file_of(results, "runs")).read()
    mine = provenance()["features"].split()
    about = table.schema.metadata | {b"wobblesim.features": " ".join([*mine[1:], "sve9"]).encode()}
    pq.write_table(table.replace_schema_metadata(about), tmp_path / "x")
    found = call(tmp_path / "x")
    assert found.exit_code == 0
    assert re.search(rf"features +sve9 +{re.escape(mine[0])}\n", found.stdout)


def test_without_a_difference_in_what_computed_it_the_fault_is_the_files_or_ours(altered):
    table = pq.ParquetFile(altered).read()
    about = table.schema.metadata | {b"wobblesim.kernel": provenance()["kernel"].encode()}
    pq.write_table(table.replace_schema_metadata(about), altered)
    found = call(altered)
    assert found.stdout.endswith("on the same processor: the file is altered, or wobblesim at fault.\n")


@pytest.mark.parametrize("arguments", [["nothing"], ["."], ["x", "--epochs", 0], ["x", "--seed", -1], []])
def test_bad_usage_is_exit_code_2(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").touch()
    found = call(*arguments)
    assert (found.exit_code, found.stdout) == (2, "")


def cli(*arguments, **options):
    command = [sys.executable, str(ROOT / "cli.py"), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_a_bad_file_is_exit_code_2_and_one_line(results, tmp_path):
    (tmp_path / "cut.parquet").write_bytes(file_of(results, "runs").read_bytes()[:-9])
    with cli("rerun", tmp_path / "cut.parquet") as process:
        out, said = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert re.fullmatch(r"\S*cut\.parquet cannot be read as Parquet: .*\n", said)


def test_ctrl_c_leaves_at_once_with_130_and_no_traceback(results, tmp_path):
    # One epoch of this takes far longer than the test: the whole of it is one call of the kernel.
    table = pq.ParquetFile(file_of(results, "epochs")).read()
    config = json.loads(table.schema.metadata[b"wobblesim.config"])
    config["trial"]["duration"], config["physics"]["dt"] = 86_400.0, 0.001
    about = table.schema.metadata | {b"wobblesim.config": json.dumps(config).encode()}
    pq.write_table(table.replace_schema_metadata(about), tmp_path / "long.parquet")
    before = sorted(tmp_path.iterdir())
    with cli("rerun", tmp_path / "long.parquet", cwd=tmp_path) as process:
        while "0 of 1 run done" not in process.stderr.readline():
            assert process.poll() is None
        time.sleep(0.3)
        begun = time.monotonic()
        process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=30)
        assert time.monotonic() - begun < 1.0  # measured 0.01 s
    assert (process.returncode, out, said) == (130, "", "")
    assert sorted(tmp_path.iterdir()) == before
