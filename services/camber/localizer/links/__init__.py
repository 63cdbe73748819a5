"""Road links: matching the vehicle to a link and holding the pose by it."""
