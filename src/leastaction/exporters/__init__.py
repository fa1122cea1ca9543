"""A model for other programs: `_write.export` and one module a format."""
