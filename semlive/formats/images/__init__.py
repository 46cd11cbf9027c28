"""Images with their scan metadata, independent of the vendor."""
