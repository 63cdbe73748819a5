"""`camber import` and `camber export`: a ROS bag becomes a drive folder, a run becomes a ROS 2 bag.

What single ROS messages mean is in `camber.formats.ros`; here are the choice of topics, the files of the drive with its
manifest, and the topics of the exported bag.
"""
