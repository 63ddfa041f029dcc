"""One file that holds a drive as it goes: what was seen, what was thought of it, and where it can go on."""
