"""What came out: stored tables as frames, statistics, figures."""
