"""Equations of a model as lists of statements on single numbers: recorded, then printed, or run on many lanes."""
