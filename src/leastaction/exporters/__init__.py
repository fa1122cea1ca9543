"""Export of models to other programs: `write.export` and one module for each format."""
