"""Files: writing them completely or not at all, and reading untrusted ones safely."""
