"""Joint estimate of drift, distortion, motion and noise from all disparity maps of a run."""
