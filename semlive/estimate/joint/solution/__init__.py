"""The solver, and the posterior of drift, distortion and motion."""
