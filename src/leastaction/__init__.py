"""leastaction: the Lagrangian of a mechanical system from noisy measured coordinates."""
