"""Commands of the panel "Before a run" in the help."""
