"""Plane geometry that several mechanics share."""
