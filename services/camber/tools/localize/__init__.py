"""`camber localize`: a drive through the localizer alone, with tables and pictures."""
