"""Inertial measurement unit: strap-down integration, levelling and noise classes."""
