"""A radar follows an airliner that flies straight most of the time and turns without notice."""
