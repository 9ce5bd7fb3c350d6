"""What all tests share: Hypothesis looks at the same examples every time, and does not mind a first, compiling call."""

from hypothesis import HealthCheck, settings

settings.register_profile("push", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("nightly", deadline=None, max_examples=2000, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("push")


def pytest_addoption(parser):
    parser.addoption(
        "--golden-update", action="store_true", help="rewrite tests/physics/golden.json with what is computed now"
    )
