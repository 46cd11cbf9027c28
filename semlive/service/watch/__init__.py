"""The export folder: which files are complete, numbered and unchanged."""
