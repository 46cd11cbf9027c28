"""Selection of noise scale, smoothness and optional terms by marginal likelihood."""
