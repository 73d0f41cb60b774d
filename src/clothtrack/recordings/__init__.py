"""Recordings of camera and picker: the format, its reader, segmentation and point clouds."""
