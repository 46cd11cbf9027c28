"""Images with their scan metadata, whatever the vendor."""
