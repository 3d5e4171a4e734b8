"""Sockets, pseudo terminals, baud rates and faults of the simulated plant."""
