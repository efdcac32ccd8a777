"""Policies against each other: matches, what agents do in them, ratings, and reports."""
