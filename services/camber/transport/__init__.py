"""Byte streams and packets from sockets, serial ports, NTRIP casters and network interfaces."""
