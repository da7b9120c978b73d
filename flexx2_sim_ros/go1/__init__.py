"""The simulated robot: model, scene and clean depth. No ROS."""
