"""`wobblesim bench`: the figures hang together, and bad options are refused in one line."""

import json

import pytest
from click.testing import CliRunner

from wobblesim.commands import main


def test_the_figures_hang_together():  # with kernels that other tests compile too
    options = ["--integrator", "impulse", "--seconds", "0.02", "--repeats", "1", "--threads", "1", "--json"]
    result = CliRunner().invoke(main, ["bench", *options])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert {"cpu", "numba", "numpy", "python"} <= found["conditions"].keys()
    assert [row["precision"] for row in found["throughput"]] == ["float32", "float64"]
    for row in found["throughput"]:
        # 4000 epochs x 20 behaviours x 60 s in steps of dt
        assert row["full_run_s"] == pytest.approx(4000 * 20 * 60 / row["dt"] / row["all_threads"])
        assert row["vector_gain"] == pytest.approx(row["one_thread"] / row["scalar"])
        assert row["scalar"] > 0


@pytest.mark.parametrize("options", [["--repeats", "0"], ["--seconds", "0"], ["--integrator", "euler"]])
def test_options_that_mean_nothing_are_refused(options):
    result = CliRunner().invoke(main, ["bench", *options])
    assert result.exit_code == 2
    assert "Traceback" not in result.output
