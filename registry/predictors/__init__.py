"""Networks and baselines that predict many steps ahead: one entry a file."""
