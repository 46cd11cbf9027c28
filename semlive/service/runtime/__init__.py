"""Processes, clocks, memory and installed drivers."""
