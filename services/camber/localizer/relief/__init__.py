"""The road's relief as horizontal evidence: heights of fixes compared with the map's elevation, without their east and
north. Not here: the road below the antenna (`road`), the states of the pose (`filter`)."""
