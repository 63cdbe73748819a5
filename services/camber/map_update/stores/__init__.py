"""Stores of contributions: SQLite and PostgreSQL."""
