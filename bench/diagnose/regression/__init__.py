"""The weak form: what a model leaves of the measured rates, linearised and set against signals."""
