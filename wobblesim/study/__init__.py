"""Many runs: which are wanted, how they are computed, where they are kept, how they go on after a stop."""
