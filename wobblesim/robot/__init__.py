"""What is simulated: bodies of point masses and springs, their morphology and their gait."""
