"""`camber evidence`: the drives of the evidence page, and the page."""
