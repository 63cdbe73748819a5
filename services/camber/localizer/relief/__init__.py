"""The road's relief as horizontal evidence: heights of fixes, without east and north, against the map's elevation.

Not here: the road below the antenna (`road`), the states of the pose (`filter`).
"""
