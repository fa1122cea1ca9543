"""Checks of a fit that need no truth."""
