"""Counts the faults that the tests of this folder inject, and says so at the end."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from faults.disk import without_fsync
from faults.scenarios import Scenario, all_but

INJECTED: Counter[str] = Counter()
"""Faults by kind; a test adds those it has injected."""


@pytest.fixture(scope="session")
def injected() -> Callable[[str, int], None]:
    """Count faults of a kind."""

    def count(kind: str, number: int = 1) -> None:
        INJECTED[kind] += number

    return count


@pytest.fixture(params=all_but("fork by copies"))
def scenario(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scenario]:
    """A piece of work, prepared in the folder `origin`."""
    (tmp_path / "origin").mkdir()
    with without_fsync():
        request.param.prepare(tmp_path / "origin")
        yield request.param


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many faults of which kind there were."""
    if INJECTED:
        terminalreporter.section(f"{sum(INJECTED.values()):,} faults injected")
        for kind, number in sorted(INJECTED.items()):
            terminalreporter.line(f"| {kind} | {number:,} |")
