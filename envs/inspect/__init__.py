"""A world as plain data and text, for pages and other programs."""
