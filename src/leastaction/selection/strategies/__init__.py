"""The search, one strategy a file: each takes a `Search` and returns it with a better fit."""
