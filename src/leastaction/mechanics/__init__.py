"""Equations of motion of candidate terms and of whole models."""
