"""A ground robot finds its way by odometry and by ranges to surveyed beacons whose scale is off by a few percent."""
