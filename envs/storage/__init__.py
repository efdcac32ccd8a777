"""Files: written whole or not at all, and untrusted ones read safely."""
