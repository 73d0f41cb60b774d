"""Recordings of other programs: ROS bags, RealSense, Kinect and folders of pictures, read whole."""
