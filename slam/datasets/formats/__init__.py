"""One file a format of recordings, and the registry that recognises and opens them."""
