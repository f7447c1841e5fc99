"""Ways to set a predictor's state from a short history: one entry a file."""
