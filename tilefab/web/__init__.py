"""Where a line's daemon is talked to: its API over a Unix socket and HTTP, and the client that the commands use."""
