"""The commands, a module each: options and help alone, so that `bench --help` answers at once.

What a command does is imported when it is run, and after its arguments were looked at: torch, pandas and MLflow take
seconds. `tests/test_imports.py` sees to it.
"""
