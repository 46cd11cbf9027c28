"""Commands of the panel "A run" in the help."""
