"""Results compared with the truth of a simulation."""
