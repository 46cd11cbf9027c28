"""Rules that stop the load frame: ordered ramps, standstill, unloading, and how far the load can go."""
