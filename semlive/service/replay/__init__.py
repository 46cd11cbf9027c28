"""A log analysed again, and maps of others imported."""
