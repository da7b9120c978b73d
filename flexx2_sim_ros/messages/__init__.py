"""The content of ROS messages as arrays and values; imports no ROS."""
