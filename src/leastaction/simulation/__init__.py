"""Integration of models and forecasts of measured motion."""
