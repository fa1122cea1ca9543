"""Measured trajectories: values, checks and readers."""
