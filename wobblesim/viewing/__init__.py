"""Looking at it: players, animations and reports."""
