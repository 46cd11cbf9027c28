"""Values of a diagnosis: effects, channels, verdict and the comparison of two runs."""
