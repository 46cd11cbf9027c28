"""Commands of the panel "Without a run" in the help."""
