"""Diagnose: find where model and data disagree, name the missing effect, add it, and show that the gap shrinks."""
