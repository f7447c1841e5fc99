"""How much of what a model leaves a network predicts from the same signals."""
