"""One run: windows of data, a model, its training, its evaluation."""
