"""Complete place recognisers (section 4.4 of the chapter), each a `place_recognition.recognizer.PlaceRecognizer`."""
