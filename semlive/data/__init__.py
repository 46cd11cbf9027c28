"""Values exchanged between packages: frozen dataclasses over read-only arrays."""
