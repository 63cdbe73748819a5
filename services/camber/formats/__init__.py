"""Native files and streams of receivers, read and written."""
