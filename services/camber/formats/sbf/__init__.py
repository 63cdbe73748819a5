"""SBF blocks of Septentrio receivers, decoded."""
