"""Sections of the report of a run, each from the data of a report: one module for each heading."""
