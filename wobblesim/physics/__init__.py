"""How it moves: lanes, laws of motion and the integrators behind one contract."""
