"""Colours of trajectories and loops, the same in every figure, page and recording.

The hues are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers can tell apart. Lines
that could still be confused have different dashes as well.
"""

GROUND_TRUTH = "#808080"  # drawn dashed
ODOMETRY = "#e69f00"
ONLINE = "#cc79a7"
CORRECTED = "#0072b2"
ACCEPTED = "#009e73"
REJECTED = "#d55e00"  # drawn dotted
SCALE_END = "#001d33"  # of the largest values in pictures of matrices


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
