"""Tables of a study's records and the statistics beside them."""
