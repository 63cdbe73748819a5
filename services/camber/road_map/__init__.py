"""The road map: releases, tiles, differences between blobs, and the vehicle's store of releases."""
