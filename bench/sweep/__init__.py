"""Sweeps: what is searched, its trials, and what came out."""
