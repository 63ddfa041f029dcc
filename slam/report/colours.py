"""One colour for each thing, in every picture, page and recording.

The hues are those that Okabe and Ito (Color Universal Design, 2008) chose for colour-blind readers.
Where two lines could still be confused their dashes differ as well.
"""

GROUND_TRUTH = "#808080"  # drawn dashed
ODOMETRY = "#e69f00"
ONLINE = "#cc79a7"
CORRECTED = "#0072b2"
ACCEPTED = "#009e73"
REJECTED = "#d55e00"  # drawn dotted
MOST = "#001d33"  # end of the scale of matrices


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue, 0 to 255, of a colour `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
