"""From disparity to displacement, strain and elastic constants."""
