"""Proposed experiments and their expected odds."""
