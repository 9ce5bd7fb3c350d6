"""Can we trust it, and what does it cost: measurements of the integrators."""
