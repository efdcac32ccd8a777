"""A world as plain data and words: what pages, play and texts share."""
