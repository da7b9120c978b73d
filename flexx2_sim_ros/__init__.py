"""A simulated PMD Flexx2 time-of-flight camera for ROS 2."""

__version__ = '0.1.0'
