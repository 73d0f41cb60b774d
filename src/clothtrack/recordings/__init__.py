"""What camera and picker recorded: the format, its reader, segmentation and point clouds."""
