"""ROS messages and bags without ROS: points, positions and motion in, verdicts and positions out.

The standard messages are those of `rosbags` (Humble's, whose fields later distributions share); `msg/` has the
definitions that it lacks, and Camber's own. What a drive is made of them is in `camber.tools.bags`.
"""
