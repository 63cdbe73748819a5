"""New estimates after an error determination: requests to gnss and the agreement of satellite subsets."""
