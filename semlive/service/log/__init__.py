"""Writing, reading, following and repairing the log of a run."""
