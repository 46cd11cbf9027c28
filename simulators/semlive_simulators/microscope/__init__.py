"""The simulated SEM: column, scan, pattern, exposure."""
