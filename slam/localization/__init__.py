"""Where was this image taken? Single images placed in a map that was saved before."""
