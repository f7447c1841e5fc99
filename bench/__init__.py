"""One run, in the order the data flows: configuration, data, training, evaluation, record, tracking."""
