"""Policies against each other: matches, measurements of behaviour, ratings and reports."""
