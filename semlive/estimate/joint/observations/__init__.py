"""From disparity maps to the normal equations: block means, priors, state."""
