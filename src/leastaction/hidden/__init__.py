"""Coordinates that no sensor saw: start values for their motion, and what is known of them."""
