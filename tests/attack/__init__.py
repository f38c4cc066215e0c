"""An attacker that shares no code with the product: its own car, kit, client, course and wire formats."""
