"""Live drift- and distortion-corrected strain measurement inside a scanning electron microscope."""
