"""What goes over the bus: frames, values, adapters."""
