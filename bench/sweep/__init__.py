"""Sweeps: what is searched, its trials, and what came out. Called itself, the package is `sweep.sweep`."""

from bench.callable_package import make_callable

make_callable(__name__)
