"""Compiled loops of the word tree."""
