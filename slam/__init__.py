"""Simultaneous localisation and mapping: odometry and place recognition composed into Figure 4.1."""

from slam.environment import prepare_caches

prepare_caches()
