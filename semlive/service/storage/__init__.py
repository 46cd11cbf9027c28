"""Storage of maps and pairs of a run in files."""
