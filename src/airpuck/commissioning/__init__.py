"""From the box to a trusted flight, alone. Entry point: `commission`."""
