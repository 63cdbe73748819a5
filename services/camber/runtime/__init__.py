"""How a service lives: settings, bus, inboxes, replay barrier, health, an orderly end. Alone in importing zenoh."""
