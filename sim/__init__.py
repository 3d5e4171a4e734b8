"""The plant, simulated: physics that shares no code with the product."""
