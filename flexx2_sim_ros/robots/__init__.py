"""Robots in a scene: model, legs and gait. No ROS."""
