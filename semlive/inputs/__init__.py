"""Bounded reading of files of users and other programs: regular files only, strict YAML, JSON of limited depth."""
