"""Foxglove's own messages, which viewers draw: positions on a map, poses, point clouds, scenes, logs, GeoJSON.

The `.bin` files are the FileDescriptorSets of the messages, as foxglove-sdk 0.30.3 gives them (MIT, Foxglove
Technologies Inc). Messages are encoded here without a library: a recorder in a vehicle then needs neither protobuf nor
the SDK. `drawings.py` says what is drawn of Camber's messages; files and sockets do not belong here.
"""
