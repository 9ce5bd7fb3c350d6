"""Files made to stop a reader are refused at once, and cost no memory."""

from __future__ import annotations

from pathlib import Path

import pytest
from config.apart import read_apart
from config.bombs import BOMBS


@pytest.mark.parametrize("name", BOMBS)
def test_bi_6_a_bomb_is_refused_in_a_fifth_of_a_second_and_100_mb(name: str, tmp_path: Path) -> None:
    found = read_apart(tmp_path / "bomb.yaml", BOMBS[name], within=0.2)
    assert found.said.startswith(str(tmp_path))
    assert (
        found.seconds < 0.2
    )  # s, measured 0.12 at most (10,000 unknown keys), 0.018 of those that the catalogue names
    assert found.peak < 100e6  # bytes, measured 48e6 at most, of which 34e6 is the package
