"""Simultaneous localisation and mapping: odometry and place recognition composed into Figure 4.1."""
