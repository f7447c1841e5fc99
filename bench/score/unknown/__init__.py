"""Effects that nobody foresaw: simulated where no catalogue has them, and what a diagnosis makes of them."""
