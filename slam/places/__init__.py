"""Place recognition alone, with one camera and without odometry: `revisit places`."""
