"""Image files of each SEM vendor."""
