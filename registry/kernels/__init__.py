"""The numeric core: recurrent loops with hand-written gradients."""
