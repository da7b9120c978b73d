"""A simulated PMD Flexx2 time-of-flight camera for ROS 2."""

__version__ = '0.2.0'
