"""When measured signals act and were true: shifts between their clocks, estimated before any effect is sought."""
