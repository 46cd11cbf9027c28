"""The nouns: frozen values over read-only arrays."""
