"""The plant, simulated: physics, wire formats and network kept apart; nothing here is shared with the product."""
