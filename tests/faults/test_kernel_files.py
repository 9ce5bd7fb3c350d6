"""Compiled kernels are cut (CR-11); what else may happen to them is in tests/physics/test_kernel_cache.py.

There is no index of them (Numba's ``.nbi``) that could be torn: each kernel is a file that says of itself what it is.
"""

import pytest
from physics.test_kernel_cache import simulate


@pytest.mark.nightly
@pytest.mark.parametrize("left", [0, 40])
def test_cut_kernels_are_compiled_anew_with_a_warning_and_the_same_bits(tmp_path, left, injected):
    whole = simulate(tmp_path, "explicit")
    assert whole[1:] == (1, "")
    assert list(tmp_path.rglob("*.nbi")) == []
    paths = list(tmp_path.rglob("*.nbc"))
    for path in paths:
        path.write_bytes(path.read_bytes()[:left])
    digest, misses, warned = simulate(tmp_path, "explicit")
    assert (digest, misses) == (whole[0], 1)
    assert "RuntimeWarning: damaged kernels" in warned
    assert simulate(tmp_path, "explicit") == (whole[0], 0, "")
    injected(f"compiled kernel cut to {left} bytes", len(paths))
