"""Loop closing: from a recognised place to a verified relative pose."""
