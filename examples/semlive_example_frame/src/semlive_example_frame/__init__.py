"""A load frame that speaks lines of JSON over TCP, and a machine to try it with."""
