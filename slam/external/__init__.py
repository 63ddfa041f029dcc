"""Parts of other programs in the chain: odometry and matches from files."""
