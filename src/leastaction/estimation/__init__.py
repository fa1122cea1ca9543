"""Curve, coefficients and weights estimated together, for one structure at a time."""
