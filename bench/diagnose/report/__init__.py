"""The diagnosis as a page, on the terminal and as a model file."""
