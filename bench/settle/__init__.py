"""Which claims are open, and which runs would settle them: seeds are added to a study until its claims are settled."""
