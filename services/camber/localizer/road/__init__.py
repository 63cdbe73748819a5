"""The road below the antenna: height, slope and the vehicle's attitude on it."""
