"""`camber access` and `camber certs`: access rules and certificates."""
