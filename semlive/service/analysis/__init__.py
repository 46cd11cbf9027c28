"""The analysis process: pairs in, results out."""
