"""What a learned term is made of: the axes it acts along, the signals it follows and the shapes it can have."""
