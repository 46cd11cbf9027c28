"""Bounded reading of what users and other programs supply: regular files only, strict YAML, JSON of limited depth."""
