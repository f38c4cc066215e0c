"""OpenDRIVE maps: reference lines by their closed forms, lanes beside them, routes through them."""
