"""What an importer leaves out or refuses: invalid lanes, level heights, heights that are not those of the source."""
