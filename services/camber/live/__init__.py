"""`camber live`: a web page of what is on the bus, of a recording or of a finished replay; it reads only.

Belongs here: sources of messages, their history as columns, the map as vector tiles, the web server and the page's own
files (`static/`). Does not belong here: anything that publishes, or that judges.
"""
