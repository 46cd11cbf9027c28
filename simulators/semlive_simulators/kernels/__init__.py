"""Compiled loops that render images."""
