"""Compiled loops over arrays and scalars; one door, `cast`, checks what comes in."""
