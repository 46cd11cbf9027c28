"""From disparity maps to drift, distortion and motion, with uncertainty."""
