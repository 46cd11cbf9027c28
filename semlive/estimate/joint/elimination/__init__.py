"""Solution of the normal equations: a block arrowhead matrix, eliminated pair by pair."""
