"""Section 4.2.1: what an image is turned into before it is compared."""
