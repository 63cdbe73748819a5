"""How a service lives: settings, bus, inboxes, queries, replay barrier, health, orderly end. Alone in importing zenoh."""
