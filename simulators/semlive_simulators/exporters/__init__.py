"""How microscopes write their files: one module a vendor, and how a file grows in the folder."""
