"""A robot finds itself in a building by a laser and an occupancy grid, without knowing where it starts."""
