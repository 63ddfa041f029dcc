"""Visual words: vocabularies trained in advance or grown online, and the search for the nearest word."""
