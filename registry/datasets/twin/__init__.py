"""Simulated aircraft, their pilots and what would have been measured of them."""
