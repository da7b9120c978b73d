"""Geometry, noise and random numbers of one frame: functions over arrays."""
