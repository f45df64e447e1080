"""A target that is followed through a clip by its colour, by a look that is learned on the way, and by its motion."""
