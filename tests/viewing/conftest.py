"""One browser for all tests of pages."""

import pytest
from viewing.browser import browser as opened


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium, or a skipped test."""
    with opened() as chromium:
        yield chromium
