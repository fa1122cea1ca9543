"""Readers and writers of `leastaction.io`: one module for each kind of file, and shared ones."""
