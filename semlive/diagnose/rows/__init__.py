"""Effects that shift rows against each other."""
