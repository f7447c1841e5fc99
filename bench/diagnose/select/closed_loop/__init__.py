"""What inputs do in closed loop: a controller's inputs cancel what nobody measured, and then seem to do nothing."""
