"""The simulated specimen, stage and test machine."""
