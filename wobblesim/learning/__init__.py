"""How the robot learns: the search, the wobble, and the runs that put them together."""
