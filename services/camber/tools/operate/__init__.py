"""Operating a vehicle and a fleet: status, health, doctor, log level, uploads."""
