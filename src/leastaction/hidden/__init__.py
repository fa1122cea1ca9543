"""Hidden coordinates: start values and standard errors of their motion, and undetectable changes."""
