"""The road map as a domain: releases, tiles, deltas and the vehicle's store."""
