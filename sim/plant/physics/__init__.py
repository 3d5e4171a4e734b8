"""What moves, prints and fires: exact, driven by events, without sockets, its time handed in."""
