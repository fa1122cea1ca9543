"""Measured trajectories: what they are, and how they are checked and read."""
