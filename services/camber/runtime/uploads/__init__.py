"""Uploads of a vehicle: durable outbox, sender, and their receipt."""
