"""Terrain-aided navigation: an inertial navigation system, a radio altimeter and a map of heights (Dahia, Musso, Pham, Guibert 2004)."""
