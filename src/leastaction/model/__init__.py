"""The model that a discovery returns: values, file, text and formulas."""
