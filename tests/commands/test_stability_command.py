"""`wobblesim stability`: the short form's data hang together, files are written, bad options are refused."""

import json

import pandas as pd
import pytest
from click.testing import CliRunner

from wobblesim.commands import main
from wobblesim.physics.scene import Physics


def test_the_short_form_has_every_part(tmp_path):
    page, out = tmp_path / "stability.md", tmp_path / "out"
    result = CliRunner().invoke(main, ["stability", "--short", "--json", "--out", str(out), "--page", str(page)])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert {"cpu", "numba", "numpy", "python"} <= found["conditions"].keys()

    limits = {(row["integrator"], row["zeta"]): row for row in found["limits"]}
    assert limits["explicit", 0.0]["measured"] == pytest.approx(8**0.5, rel=1e-4)
    assert limits["midpoint", 0.0]["measured"] is None  # none; JSON has no infinity

    assert len(found["box"]) == 2 * 9  # two integrators, 3 x 3 morphologies, one step
    adult = [row for row in found["box"] if row["mass"] == row["stiffness"] == row["size"] == 1]
    assert [row["class"] for row in adult if row["integrator"] == Physics().integrator] == ["ok"]
    assert {row["dimension"] for row in found["safe"]} == {"mass", "stiffness", "size", "gravity"}

    frames = {path.stem: pd.read_parquet(path) for path in out.glob("*.parquet")}
    assert set(frames) == set(found) - {"conditions"} | {"curves"}
    assert all(len(frames[name]) == len(found[name]) for name in frames if name != "curves")
    for name in ("spring", "box-midpoint-float32", "explicit", "factors"):
        assert (out / f"{name}.png").stat().st_size > 5_000
        assert (out / f"{name}.svg").read_text().rstrip().endswith("</svg>")

    text = page.read_text()
    assert "$" not in text
    assert "short form" in text
    shown = sorted((tmp_path / "_static").glob("*.png"))
    assert [picture.name for picture in shown] == [f"stability-{path.name}" for path in sorted(out.glob("*.png"))]
    for picture in shown:
        assert f"(_static/{picture.name})" in text
        assert picture.with_suffix(".svg").read_text().rstrip().endswith("</svg>")


@pytest.mark.parametrize("options", [["--short", "--write-safe"], ["--dt", "0.01"], ["--out", __file__]])
def test_options_that_mean_nothing_are_refused(options):
    result = CliRunner().invoke(main, ["stability", *options])
    assert result.exit_code == 2
    assert "Traceback" not in result.output
