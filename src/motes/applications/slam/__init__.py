"""A robot that does not know where its landmarks are: beacons that it measures ranges to, or objects that it sees."""
