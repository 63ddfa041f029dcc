"""Visual words: vocabularies trained in advance or grown on the way, and the search for the nearest word."""
