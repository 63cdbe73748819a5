"""The cloud side of the fleet: each upload is kept once, and acknowledged only when it is on the disk."""
