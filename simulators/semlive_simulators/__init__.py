"""A virtual SEM, load frame and stage."""
