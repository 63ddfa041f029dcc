"""What the world looks like: landmarks that move with the key frames that saw them."""
