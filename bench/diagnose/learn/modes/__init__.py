"""Hidden dynamics: what is left swings or relaxes, and measured signals drive it."""
