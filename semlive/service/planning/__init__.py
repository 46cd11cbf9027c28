"""Duration, noise and stop distances of a planned run."""
