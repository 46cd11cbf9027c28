"""Diagnosis of one or two logs, and what follows from it."""
