"""What ROS messages say, as arrays and values; imports no ROS."""
