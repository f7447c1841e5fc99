"""A user's own folder of files with a `dataset.toml`: what it says, and how the files are read by it."""
