"""Which terms are in the model."""
