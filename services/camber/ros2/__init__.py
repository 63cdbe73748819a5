"""A node of a ROS 2 graph that uses rmw_zenoh, without ROS: sensors in, judged positions out.

Messages and their conversion are in `camber.formats.ros`; here are rmw_zenoh's keys, and what goes in and out live.
"""
