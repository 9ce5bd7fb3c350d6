"""The integrators, by name. A new method is a file and a line here; tests, bench and reports iterate over it."""

from __future__ import annotations

from wobblesim.physics import explicit, impulse, midpoint
from wobblesim.physics.contract import Integrator

INTEGRATORS: dict[str, Integrator] = {
    module.INTEGRATOR.name: module.INTEGRATOR for module in (midpoint, impulse, explicit)
}
