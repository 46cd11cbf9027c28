"""Commands of the panel "After a run" in the help."""
