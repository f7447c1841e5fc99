"""The mirror of records in MLflow; they are the truth, and all of it can be rebuilt from them."""
