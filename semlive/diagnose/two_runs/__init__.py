"""Comparison of two runs: effects that one run cannot separate from distortion."""
