"""State machines and bookkeeping of the line, as pure functions and plain objects: no files, clocks or sockets."""
